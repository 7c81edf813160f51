"""Wrong input of every command ends with 2 and one line that says why, before anything is written."""

import sys
from pathlib import Path
from typing import Any

import pytest

import mecp_env
from mecp_env.cli import main as cli
from mecp_env.world.layout import LIBRARY
from tests.policies.test_suites import TwoActions

LINES = {
    "demo": [
        ("--layout easy:0-3", "layout: easy:0-3 is 4 buildings; name one building, as easy:0"),
        ("--layout castle", "castle: no such file or building; there are furnished, office, paper, twins, two_"),
        ("--layout two_rooms --seed -1", "--seed: Input should be greater than or equal to 0 (given: -1)"),
        ("--out notes.txt", "notes.txt is a file, not a folder; choose another place"),
        ("--layout two_rooms --render human", "render_mode: 'human' can open no window"),
        ("--with no_such_module", "--with no_such_module: ModuleNotFoundError: No module named 'no_such_module'"),
        ("--with broken.py", "a module is named as `import` names it: broken"),
        ("--with broken", "--with broken: ZeroDivisionError: division by zero"),
    ],
    "play": [
        ("--rate 0", "--rate: Input should be greater than or equal to 0.5 (given: 0.0)"),
        ("--config.start 50 50 0", "start: (50.0, 50.0, 0.0)"),
        ("", "start it on a desktop or with DISPLAY set"),
    ],
    "one-scan": [
        ("--layout easy", "easy: which buildings?"),
        ("--layout two_rooms --step 99999", "step: no polygon is recognised from 99999 on; the exploration ends at "),
        ("--step -5", "--step: Input should be greater than or equal to 0 (given: -5)"),
    ],
    "slam": [
        ("a.log --laser-yaw-deg 400", "--laser-yaw-deg: Input should be less than or equal to 180 (given: 400.0)"),
    ],
    "replay": [
        ("nowhere", "there is no such file or folder"),
        ("empty", "neither replay.html nor a config.json"),
        ("notes.txt", "no replay of mecp_env"),
        ("mapped", "no run of `mecp-env demo`"),
    ],
    "doctor": [
        ("--seconds=0", "--seconds: Input should be greater than or equal to 0.1 (given: 0.0)"),
    ],
    "explore nearest": [
        ("--layout easy:test", "easy:test: seeds are whole numbers"),
        ("--layout easy:test:0-3", "'easy:test:0-3', expected DIFFICULTY:SPLIT:NUMBER"),
        ("--layout easy:test:1000000", "building: 1000000"),
        ("--layout two_rooms --steps 0", "--steps: Input should be greater than or equal to 1 (given: 0)"),
        ("--layout paper --difficulty hard", "--difficulty hard: --layout paper fixes it"),
        ("--difficulty hrd", "did you mean 'hard'?"),
        ("--difficulty hard --split tst", "did you mean 'test'?"),
        ("--split test", "--split: has a meaning with --difficulty or --task only"),
        ("--layout plan.json --save-map plans", "--save-map: plans is a folder, not a file"),
        ("--layout plan.json --save-map plan.json/map.zip", "plan.json is a file, not a folder"),
        ("--layout plan.json --save-map plan.json", "plan.json is what is read"),
        ("--layout plan.json --save-map notes.txt", "notes.txt: no mecp_env map, or cut short; name another file"),
        ("--save-map map.zip --estimator known", "map.zip: a map of the estimator 'known' localises with ground truth"),
    ],
    "explore nearst": [("", "did you mean 'nearest'?")],
    "evaluate": [("", "policies: expected at least one of bfs")],
    "evaluate nearest": [
        ("--episodes 5000", "episodes: 5000, each in a building of 'test'; building: 4999, there are 1000"),
        ("--reference gian", "did you mean 'gain'"),
        ("--max-steps 0", "--max-steps: Input should be greater than or equal to 1 (given: 0)"),
        ("--json page.md", "json: page.md: expected"),
        ("--shard 3/2", "shard: '3/2', expected NUMBER/COUNT such as 1/4"),
        ("--plans empty", "no file in it ends in"),
        ("--layout hard:7", "--difficulty selects generated buildings"),
        ("--plans x --layout office", "--layout office: --plans x fixes it"),
        ("--suite active-v1 --plans x", "--plans x: --suite active-v1 fixes it"),
        ("--resolution-m 0.05", "--resolution-m: has a meaning with --plans or --layout only; name one"),
    ],
    "evaluate nearest nowhere:Policy": [("", "cannot be constructed: No module named 'nowhere'")],
    "evaluate random:Random": [("", "'random:Random' has no 'actions'")],
    "record-dataset bfs": [
        ("--difficulty esy", "difficulty: 'esy', expected one of easy"),
        ("--task ActiveHall-v0", "did you mean 'ActiveHalls-v0'"),
        ("--episodes 0", "--episodes: Input should be greater than or equal to 1"),
    ],
    "submit": [
        ("nearest --suite active-v9", "did you mean 'active-v1'"),
        ("nearest --suite active-v1 --quick", "--suite active-v1: --quick fixes it; leave out one of the two"),
        ("nearest --quick --out x.txt", "x.txt: expected the name of a file that ends in .json"),
        ("nearest --quick --hours nan", "--hours"),
        ("nearest --quick --seeds 0", "--seeds"),
        (f"{TwoActions.__module__}:TwoActions", "settings of actions 'velocity', but its `actions` are 'goal'"),
    ],
    "train": [
        ("sac", "'sac' is not one of ppo, maskable_ppo, recurrent_ppo"),
        ("--seed 1", "ppo, maskable_ppo, recurrent_ppo"),
        ("ppo --buildings.difficulty easy mediun", "did you mean 'medium'"),
        ("ppo --buildings.layout a\x1b[31mb --out new", "buildings.layout: a?[31mb: no such file"),
    ],
    "worlds draw": [
        ("", "name at least one building"),
        ("medium:9-0", "medium:9-0: the first seed comes first, as medium:0-9"),
        ("medium:0-99999", "100000 buildings"),
        ("easy:99999999999999999999", "18 digits at most"),
        ("easy:0-100", "101 buildings cannot be drawn on one sheet"),
        ("office --out plan.jpg", "plan.jpg: a picture ends in .png or .svg"),
    ],
    "worlds validate": [("", "name at least one building")],
    "worlds generate": [
        ("--count 0", "--count: Input should be greater than or equal to 1 (given: 0)"),
        ("--count 2 --out one.json", "one.json is one file for 2 buildings"),
        ("--out plans.yaml", "plans.yaml is the name of a file, not of a folder"),
        ("--split test --seed 998 --count 5", "seed: 998, with count 5 up to index: 1002"),
    ],
    "worlds convert": [
        ("office office.txt", ".json, .yaml, .svg"),
        ("easy:0-1 two.json", "source: easy:0-1 is 2 buildings; name one building, as easy:0"),
        ("office map.yaml --map-resolution-m 2", "map_resolution_m: from 0.005 to 1 m"),
        ("paper new/below/map.yaml --map-resolution-m 0.5", "map_resolution_m: "),
    ],
}


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, bytes]:
    """What there is in the working directory: by name, with its content."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SDL_VIDEODRIVER", "none_such")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    for name in ("plans", "empty", "mapped"):
        Path(name).mkdir()
    plan = (LIBRARY / "two_rooms.json").read_bytes()
    content = {"plan.json": plan, "plans/a.json": plan, "plans/b.json": plan, "notes.txt": b"mine"}
    content |= {"mapped/config.json": b'{"log": "x.log"}', "broken.py": b"1 / 0\n"}
    for name, data in content.items():
        Path(name).write_bytes(data)
    return content


@pytest.mark.parametrize(
    ("line", "said"), [(f"{words} {options}", said) for words, rows in LINES.items() for options, said in rows]
)
def test_wrong_input_is_one_line_and_changes_nothing(
    line: str, said: str, files: dict[str, bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(line.split()) == 2
    told = capsys.readouterr().err
    assert told.startswith("mecp-env: ")
    assert said in told
    assert told.count("\n") == 1
    left: dict[str, Any] = {str(path): path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    assert left == files


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        ("", 2, "demo"),
        ("dmo", 2, "did you mean 'demo'?"),
        ("worlds", 2, "worlds stats"),
        ("demo --config.slam.filter.kindd ekf", 2, "--config.slam.filter.kind"),
        ("demo --config.slam.filter.kind ukf", 2, "riekf"),
        ("demo --config.max-steps 0", 2, "Error parsing config: --config.max_steps: Input"),
        ("demo --config.observation.format image", 2, "observation.format: 'image', expected 'dict'"),
        ("train ppo --buildings.spec 12 rooms", 2, "the name of a field comes first"),
        ("train ppo --buildings.spec rooms 12 loops", 2, "loops: a value is missing"),
        ("evaluate nearest --env.estimator truth", 2, "Unrecognized options: --env.estimator"),
        ("evaluate nearest --env.slam.grid.resolution_m 0.9", 2, "slam.grid.resolution_m: 0.9 m, at most 0.44 m"),
        ("evaluate nearest --estimator slm", 2, "did you mean 'slam'"),
        ("evaluate nearest --env.reward.custom mine 1", 2, "mine: not registered"),
        ("--help", 0, "one-scan"),
        ("--version", 0, mecp_env.__version__),
        ("demo --help", 0, "mecp-env demo --layout office"),
        ("worlds generate --difficulty huge --help", 0, "(default: 40)"),
    ],
)
def test_a_line_that_nothing_is_run_for_says_why(
    line: str, code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(line.split())
    assert ended.value.code == code
    streams = capsys.readouterr()
    assert said in streams.err + streams.out
