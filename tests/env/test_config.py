import json
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from mecp_env.config import EnvConfig
from mecp_env.core.errors import ConfigError, KeywordError, MecpError
from mecp_env.env import MecpEnv
from mecp_env.slam.config import SlamConfig
from mecp_env.world.config import LaserConfig
from mecp_env.world.layout import load_layout

UNKNOWN = [
    ({"observation": {"fromat": "flat"}}, r"EnvConfig\.observation\.fromat: no such field; did you mean 'format'\?"),
    ({"slam": {"filter": {"knd": "ekf"}}}, r"EnvConfig\.slam\.filter\.knd: no such field; did you mean 'kind'\?"),
    ({"reward": {"zzz": 1.0}}, r"EnvConfig\.reward\.zzz: no such field \(fields: preset, source, area"),
]
WRONG = [{"max_steps": value} for value in (0, 1.5, "10", True)]
WRONG += [{"start": value} for value in ("nowhere", (1.0, 2.0), (True, 2.0, 0.0))]
WRONG += [{"laser": None}, {"laser": {"sweeps": 99}}, {"robot": {"arcs": 0}}, {"robot": {"period_s": 3.0}}]
WRONG += [{"observation": value} for value in (3, "flatt", {"map": 1}, {"format": "flat", "scan": True})]
WRONG += [
    {"slam": section} for section in ({"corners": {"door_width_m": (1, 0.5)}}, {"grid": {"resolution_m": np.nan}})
]
WRONG += [{"layout": 3}, {"actions": "jump"}, {"end": {"coverage": 1.5}}, {"reward": {"time": np.inf}}]
IN_VAIN = [  # nothing can be explored
    ({"slam": {"grid": {"resolution_m": 1.0}}}, r"slam\.grid\.resolution_m: 1 m, at most 0\.44 m"),
    ({"planning": {"paths": {"radius_m": 2.0}}}, r"planning\.paths\.radius_m .*: 4\.1 m, at most 1\.95 m"),
    ({"robot": {"radius_m": 1.5}}, r"radius_m .*: 3\.1 m, at most 1\.95 m"),
    ({"laser": {"beams": 8}}, r"laser\.beams: 8, at least 20"),
    ({"laser": {"x_m": 0.2, "y_m": -0.1}}, r"laser: hypot\(x_m, y_m\): 0\.223607 m, at most 0\.198 m, 0\.9 robot\.rad"),
]


@pytest.mark.parametrize(("fields", "message"), UNKNOWN + IN_VAIN + [(each, next(iter(each))) for each in WRONG])
def test_unknown_names_get_the_nearest_and_wrong_values_their_field_and_bound(fields, message):
    with pytest.raises(ConfigError, match=message):
        EnvConfig.build(fields)
    with pytest.raises(ConfigError, match=message):
        EnvConfig.build(**fields)


def test_an_unknown_keyword_is_refused_in_the_words_of_python():
    said = "got an unexpected keyword argument 'layuot'; did you mean 'layout'"
    for make in (EnvConfig.build, partial(gymnasium.make, "mecp_env/Layout-v0")):
        with pytest.raises(KeywordError, match=said):
            make(layuot="paper")
    assert issubclass(KeywordError, TypeError)
    with pytest.raises(MecpError, match="atlantis"):
        gymnasium.make("mecp_env/Layout-v0", layout="atlantis")
    with pytest.raises(ConfigError, match="render_mode"):
        MecpEnv(render_mode="hologram")
    with pytest.raises(ConfigError, match="expected a dict"):
        EnvConfig.build([("layout", "paper")])
    with pytest.raises(ConfigError, match="no such field"):
        SlamConfig.parse({"panorama": {1: 2}})


def test_a_wrong_value_in_a_section_is_told_once_by_its_whole_path():
    with pytest.raises(ConfigError) as told:
        EnvConfig.build({"slam": {"filter": {"kind": "ekff"}, "rooms": {"doorway_m": "x"}}})
    assert str(told.value).startswith("EnvConfig.slam.filter.kind: Input should be 'riekf', 'riekf_submaps', ")
    assert str(told.value).count("Config.") == str(told.value).count("EnvConfig.") == str(told.value).count("(given")


@pytest.mark.parametrize(
    "form", [str, Path, load_layout, lambda path: json.loads(path.read_text())], ids=["str", "Path", "Layout", "dict"]
)
def test_a_layout_is_a_name_a_path_a_layout_or_a_dict(form, tmp_path):
    path = tmp_path / "mine.json"
    path.write_text(load_layout("twins").to_json())
    env = gymnasium.make("mecp_env/Layout-v0", layout=form(path))
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    config = EnvConfig(layout=form(path))
    assert load_layout(config.layout) == load_layout("twins")
    assert EnvConfig.build(json.loads(config.to_json())) == config == again.unwrapped.config == env.unwrapped.config


def test_keywords_override_the_config_field_by_field():
    config = EnvConfig.build({"laser": {"preset": "ideal", "sweeps": 2}}, laser={"sweeps": 3}, max_steps=7)
    config = EnvConfig.build(config, laser=LaserConfig(preset="lms200"))
    assert (config.laser.preset, config.laser.sweeps, config.max_steps) == ("lms200", 3, 7)


def test_the_sensor_model_follows_the_laser_unless_it_is_set():
    fixed = EnvConfig.build(laser={"preset": "lms200"}, slam={"sensor": {"range_sigma_m": 0.2}})
    assert EnvConfig.build(fixed.to_dict()).estimator_config.sensor.range_sigma_m == 0.2
    config = EnvConfig.build(laser={"field_of_view_deg": 180.0, "x_m": 0.1, "heading_deg": -90.0})
    sensor = EnvConfig.build(config.to_dict()).estimator_config.sensor
    assert (sensor.field_of_view_deg, sensor.x_m, sensor.heading_deg) == (180.0, 0.1, -90.0)
    other = EnvConfig.build(config, slam={"sensor": {"x_m": 0.0}})
    assert other.estimator_config.sensor.T_robot_laser.tolist() == [0.0, 0.0, -np.pi / 2.0]


def test_the_planner_follows_the_robot_unless_it_is_set():
    config = EnvConfig.build(robot={"radius_m": 0.3, "max_speed_m_s": 0.5}, planning={"control": {"turn_rad_s": 1.0}})
    planning = config.planning_config
    assert (planning.paths.radius_m, planning.control.speed_m_s, planning.control.turn_rad_s) == (0.3, 0.5, 1.0)
    methods = [EnvConfig.build(estimator=name).estimator_config.association.method for name in ("known", "truth")]
    assert methods == ["known", "mecp"]


def test_the_paper_assumes_its_noise_with_any_laser():
    """IV: "the standard deviation of the SICK laser is assumed": noise on every beam, or only in the filter."""
    for laser in ({}, {"preset": "ideal"}):
        config = EnvConfig.paper(laser=laser)
        sensor = config.estimator_config.sensor
        assert (sensor.range_sigma_m, sensor.bearing_sigma_deg) == (0.05, 0.3)
        assert config.laser.range_sigma_m == (0.0 if laser else 0.05)
