import json

import pytest

from mecp_env.cli import main as cli
from mecp_env.cli.base import Line
from mecp_env.cli.train import Train
from mecp_env.core.errors import ConfigError
from mecp_env.learning.config import ALGORITHMS, TrainConfig, read_config


def parse(words: list[str]) -> TrainConfig:
    """The configuration of `mecp-env train` with a line of options."""
    line = Line(words)
    command = cli.parse("train", line)
    assert isinstance(command, Train)
    return (command.resumed(line) if command.resume else command.new(line))[0]


def test_every_field_of_environment_and_algorithm_is_an_option():
    line = "maskable_ppo --steps 50 --env.estimator truth --env.laser.max-range-m 12 --ppo.no-anneal --network.width 32"
    config = parse(line.split())
    assert (config.steps, config.env.estimator, config.env.laser.max_range_m) == (50, "truth", 12.0)
    assert (config.ppo.anneal, config.network.width, config.actions) == (False, 32, "goal")
    assert parse(["ppo", "--env.max-steps", "90"]).env.max_steps == 90  # a number
    config = parse(["ppo", "--env.laser.preset", "lms200"])  # what is not named still follows from other fields
    assert config.env.estimator_config.sensor.range_sigma_m == 0.01


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_configuration_file_reproduces_the_configuration(algorithm, tmp_path):
    line = [algorithm, "--seed", "3", "--env.crowd.people", "2", "--buildings.difficulty", "easy", "hard"]
    config = parse(line)
    path = tmp_path / "config.json"
    path.write_text(json.dumps(config.to_dict()))
    again = parse(["--config", str(path)])
    assert again == config
    assert again.env.estimator_config == config.env.estimator_config


def test_a_building_may_be_specified_by_numbers_ranges_and_words(tmp_path):
    spec = {"rooms": 12, "door_width_m": [0.7, 0.9], "shapes": ["L", "T"], "pieces": "box", "turned_deg": [-30, 30]}
    path = tmp_path / "config.json"
    path.write_text(json.dumps({"algorithm": "ppo", "buildings": {"spec": spec}}))
    config = parse(["--config", str(path)])
    words = "rooms 12 door_width_m 0.7 0.9 shapes L T pieces box turned-deg -30 30"
    assert parse(["ppo", "--buildings.spec", *words.split()]) == config
    assert TrainConfig.build(config.to_dict()) == config
    above = parse(["--config", str(path), "--buildings.spec", "door_width_m", "0.8"])
    assert above.buildings.spec == config.buildings.spec | {"door_width_m": (0.8, 0.8)}


def test_options_stand_above_the_file(tmp_path):
    path = tmp_path / "config.json"
    fields = {"algorithm": "ppo", "seed": 4, "ppo": {"epochs": 9}, "buildings": {"difficulty": "easy"}}
    path.write_text(json.dumps(fields))
    config = parse(["--config", str(path), "--seed", "5", "--buildings.spec", "rooms", "3"])
    assert (config.algorithm, config.seed, config.ppo.epochs) == ("ppo", 5, 9)
    # three rooms are too few for the corridor of `medium`, which is the default of the line
    assert (config.buildings.difficulty, config.buildings.spec) == (("easy",), {"rooms": 3})


def test_each_algorithm_has_defaults_of_its_own_and_is_paid_the_metric():
    configs = {name: TrainConfig.build({"algorithm": name}) for name in ALGORITHMS}
    assert {name: config.actions for name, config in configs.items()} == {
        "ppo": "velocity",
        "maskable_ppo": "goal",
        "recurrent_ppo": "velocity",
    }
    assert configs["ppo"].ppo.discount < 1.0 == configs["maskable_ppo"].ppo.discount
    assert {config.env.reward.preset for config in configs.values()} == {"coverage"}
    assert TrainConfig.build({"env": {"reward": {"time": -0.01}}}).env.reward.preset == "terms"


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"ppo": {"epoch": 3}}, "did you mean 'epochs'"),
        ({"env": {"laser": {"beems": 90}}}, "did you mean 'beams'"),
        ({"env": {"laser": {"beams": "90"}}}, r"TrainConfig\.env\.laser\.beams: Input should be a number"),
        ({"env": {"observation": "flat"}}, r"env\.observation\.format: 'flat', expected 'dict'"),
        ({"env": {"layout": "paper"}}, r"env\.layout: .*buildings\.layout"),
        ({"env": {"actions": "goal"}}, r"env\.actions: follows from the algorithm"),
        ({"buildings": {"spec": {"estimator": 1}}}, r"spec\.estimator: no such field"),
        ({"buildings": {"layout": "paper", "spec": {"rooms": 3}}}, "'paper' is one building"),
        ({"buildings": {"spec": {"shapes": ["L", 3]}}}, r"shapes\.1: Input should be 'L', 'T' or 'U'"),
    ],
)
def test_a_wrong_field_in_a_file_is_refused_with_the_nearest_name(fields, said, tmp_path):
    path = tmp_path / "config.json"
    path.write_text(json.dumps({"algorithm": "maskable_ppo"} | fields))
    with pytest.raises(ConfigError, match=said):
        parse(["--config", str(path)])


@pytest.mark.parametrize("algorithm", ["maskable_ppo", "recurrent_ppo"])
def test_a_last_batch_of_one_decision_is_refused_with_a_size_that_will_do(algorithm):
    """sb3-contrib divides by the deviation of its one advantage: after the update every weight was NaN."""
    sizes = {"algorithm": algorithm, "environments": 1, "ppo": {"steps": 7, "batch": 6}}
    with pytest.raises(ConfigError, match=r"ppo\.batch: 6 leaves a last batch of 1 of the 7 decisions.*ppo\.batch 7"):
        TrainConfig.build(sizes)
    with pytest.raises(ConfigError, match=r"ppo\.batch 5 does not"):
        TrainConfig.build(sizes | {"environments": 3, "ppo": {"steps": 3, "batch": 4}})
    assert TrainConfig.build(sizes | {"ppo": {"steps": 7, "batch": 7}}).ppo.batch == 7
    assert TrainConfig.build(sizes | {"algorithm": "ppo"}).ppo.batch == 6


@pytest.mark.parametrize(
    ("text", "said"),
    [
        *((text, r"config\.json") for text in ("", "[1]", "{", "[" * 100_000, "\x00")),
        ('{"seed": 1, "ppo": {"epochs": 3, "epochs": 4}}', r"config\.json: epochs: given 2 times in one object"),
    ],
)
def test_a_file_that_is_no_configuration_is_refused(text, said, tmp_path):
    path = tmp_path / "config.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_config(path)


@pytest.mark.slow
def test_resuming_takes_the_configuration_of_the_run_and_nothing_else(tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"algorithm": "ppo", "steps": 10}))
    assert parse(["--resume", str(tmp_path), "--steps", "20"]).steps == 20
    for line in (["--seed", "1"], ["--out", "elsewhere"], ["--ppo.epochs", "2"]):
        with pytest.raises(ConfigError, match="only --steps"):
            parse(["--resume", str(tmp_path), *line])
    with pytest.raises(ConfigError, match="No such file"):
        parse(["--resume", str(tmp_path / "nothing")])
