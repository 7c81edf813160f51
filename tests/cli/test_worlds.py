"""`mecp-env worlds`: the files each command writes, and its errors for wrong input."""

import errno
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from PIL import Image

from mecp_env.cli import main as cli
from mecp_env.cli.options import Reading
from mecp_env.world.config import GeneratorSpec
from mecp_env.world.generator import generate
from mecp_env.world.layout import load_layout
from tests.floorplans import plans

pytestmark = pytest.mark.usefixtures("draft_figures")

Said = pytest.CaptureFixture[str]


def run(*line: str | Path) -> int:
    """The exit code of a command."""
    try:
        return cli.main(["worlds", *map(str, line)])
    except SystemExit as ended:
        return int(ended.code or 0)


def test_the_list_names_every_shipped_layout_preset_and_split(capsys: Said) -> None:
    assert run("list") == 0
    said = capsys.readouterr().out
    for word in ("paper", "two_rooms", "huge:SEED", "furniture 0.3", "2000000 to 2000999 for test"):
        assert word in said


def test_buildings_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("draw", "hard:3", "--out", "new/plan.png", "--dpi", "60") == 0
    with Image.open("new/plan.png") as picture:
        assert picture.width > 300
    assert run("draw", "two_rooms", "easy:1", "--dpi", "30") == 0
    assert run("draw", "easy:0-3", "two_rooms", "--out", "sheet.svg") == 0
    assert capsys.readouterr().out.split() == ["new/plan.png", "runs/worlds.png", "sheet.svg"]


def test_generated_files_are_the_buildings_of_their_seeds(tmp_path: Path, capsys: Said) -> None:
    sheet, series = tmp_path / "sheet.png", ["--seed", "4", "--count", "2"]
    assert run("generate", "--difficulty", "easy", *series, "--out", tmp_path, "--sheet", sheet) == 0
    said = capsys.readouterr().out.splitlines()
    assert said == [*(f"{tmp_path}/easy-{seed}.json: 4 rooms, 3 doors, 0 obstacles" for seed in (4, 5)), str(sheet)]
    assert load_layout(tmp_path / "easy-5.json") == generate(GeneratorSpec.preset("easy"), 5)
    assert sheet.stat().st_size > 10_000
    assert run("generate", "--difficulty", "easy", "--split", "test", "--seed", "3", "--out", tmp_path / "test") == 0
    assert [path.name for path in (tmp_path / "test").iterdir()] == ["easy-2000003.json"]


def test_every_field_of_the_specification_is_an_option_over_the_difficulty(tmp_path: Path) -> None:
    out = tmp_path / "one.json"
    line = ["--rooms", "6", "--door-width-m", "0.8", "1.1", "--shapes", "L", "--difficulty=medium", "--seed", "2"]
    assert run("generate", *line, "--out", out) == 0
    spec = GeneratorSpec.preset("medium", rooms=6, door_width_m=(0.8, 1.1), shapes=("L",))
    assert load_layout(out) == generate(spec, 2)
    line = ["--door-width-m", "0.8", "--turned-deg", "-30", "--wall-thickness-m", "0.1", "0.2", "--out", out]
    assert run("generate", "--difficulty", "easy", *line) == 0  # a single number is a range
    fields = {"door_width_m": 0.8, "turned_deg": -30.0, "wall_thickness_m": (0.1, 0.2)}
    assert load_layout(out) == generate(GeneratorSpec.preset("easy", **fields), 0)


def test_validation_says_of_each_file_what_is_wrong_and_where(tmp_path: Path, capsys: Said) -> None:
    fields = json.loads(load_layout("two_rooms").to_json())
    (tmp_path / "a.json").write_text(json.dumps(fields))
    fields["doors"][0]["width_m"] = 9.0
    (tmp_path / "b.json").write_text(json.dumps(fields))
    (tmp_path / "c.json").write_text("{")
    assert run("validate", tmp_path) == 2
    first, second, third = capsys.readouterr().out.splitlines()
    assert first == f"ok     {tmp_path}/a.json: 2 rooms, 1 door, 0 obstacles"
    assert second.startswith(f"wrong  {tmp_path}/b.json: doors.0.width_m: 9")
    assert third.startswith(f"wrong  {tmp_path}/c.json: no JSON")
    (tmp_path / "empty").mkdir()
    assert run("validate", tmp_path / "empty", "", "no\nfile", "easy:0") == 2
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["wrong"] * 3 + ["ok"]


def test_a_building_is_converted_to_each_format_and_back(tmp_path: Path, capsys: Said) -> None:
    out = tmp_path / "deep" / "copy.json"
    assert run("convert", "furnished", out) == 0
    assert load_layout(out) == load_layout("furnished")
    assert capsys.readouterr().out == f"{out}: furnished, 4 rooms, 4 doors, 11 obstacles\n"
    for target in ("paper.svg", "twins.yaml"):
        assert run("convert", Path(target).stem, tmp_path / target) == 0
    assert ET.parse(tmp_path / "paper.svg").getroot().tag.endswith("svg")
    image, back = tmp_path / "twins.pgm", tmp_path / "twins.json"
    assert run("convert", tmp_path / "twins.yaml", back) == 0
    assert (len(load_layout(back).rooms), len(load_layout(back).doors)) == (8, 8)
    for told in ("name a map_server yaml (twins.yaml lies beside it)", "name a map_server yaml\n"):
        assert run("draw", image) == 2
        assert told in capsys.readouterr().err
        (tmp_path / "twins.yaml").unlink(missing_ok=True)
    assert run("convert", image, back, "--resolution-m", "0.05") == 0
    assert len(load_layout(back).rooms) == 8


def test_nothing_that_a_building_is_read_from_is_overwritten(tmp_path: Path, capsys: Said) -> None:
    assert run("convert", "two_rooms", tmp_path / "b.yaml") == 0
    sheet, image, coarse = tmp_path / "a.yaml", tmp_path / "b.pgm", ("--map-resolution-m", "0.1")
    (tmp_path / "b.yaml").rename(sheet)  # it names b.pgm
    scan, picture = image.read_bytes(), tmp_path / "scan.png"
    Image.open(image).save(picture)
    (tmp_path / "link.pgm").symlink_to(image)
    drawn = picture.read_bytes()
    for source, target in ((sheet, "b.yaml"), (sheet, "link.yaml"), (image, "b.yaml")):
        assert run("convert", source, tmp_path / target, *coarse, "--resolution-m", "0.05") == 2
        assert "name another file" in capsys.readouterr().err
    assert run("draw", picture, "--out", picture, "--resolution-m", "0.05") == 2
    assert (image.read_bytes(), picture.read_bytes()) == (scan, drawn)
    assert not (tmp_path / "b.yaml").exists()
    assert run("convert", sheet, tmp_path / "c.yaml", *coarse) == 0


def test_figures_are_told_as_a_table_or_as_json(tmp_path: Path, capsys: Said) -> None:
    path = tmp_path / ("long-" * 20 + "name.json")  # which leaves space for the figures
    path.write_text(load_layout("office").to_json())
    assert run("stats", "paper", "easy:0-4", path) == 0
    paper = next(line.split() for line in capsys.readouterr().out.splitlines() if "paper" in line)
    assert paper == ["paper", "9", "11", "3", "267", "98", "98", "3", "0.0"]
    assert run("stats", "easy:0-4", "--json") == 0
    easy = json.loads(capsys.readouterr().out)["easy:0-4"]
    assert (easy["buildings"], easy["rooms"]["max"]) == (5, 4)
    assert run("stats", "--json") == 0  # without a word the shipped ones
    assert json.loads(capsys.readouterr().out).keys() == {"furnished", "office", "paper", "twins", "two_rooms"}


def test_a_folder_is_its_plans_and_those_below(tmp_path: Path) -> None:
    below = tmp_path / "below"
    below.mkdir()
    assert run("convert", "office", tmp_path / "office.json") == 0
    assert run("convert", "two_rooms", below / "small.yaml") == 0
    (below / "alone.pgm").write_bytes((below / "small.pgm").read_bytes())
    assert Reading().expand(str(tmp_path)) == [str(below / "small.yaml"), str(tmp_path / "office.json")]
    assert Reading(kind="layout").expand(str(tmp_path)) == [str(tmp_path / "office.json")]
    assert Reading(kind="image", resolution_m=0.05).expand(str(tmp_path)) == [str(below / "alone.pgm")]


def test_a_building_may_be_called_anything(tmp_path: Path, capsys: Said) -> None:
    name = "a$b_$^{ nul\0l\x1b[2J部屋 <&--> é\n[red]m[/]" + "x" * 40
    fields = json.loads(load_layout("two_rooms").to_json())
    old, fields["name"], fields["rooms"][0]["name"] = fields["rooms"][0]["name"], name, name
    fields["doors"][0]["rooms"] = [name if room == old else room for room in fields["doors"][0]["rooms"]]
    path, svg, out = tmp_path / "[b]\x1b[2Jodd.json", tmp_path / "odd.svg", tmp_path / "odd"
    path.write_text(json.dumps(fields))
    assert run("draw", path, "--out", svg) == 0
    assert ET.parse(svg).getroot() is not None
    for line in (["convert", path, tmp_path / "copy.json"], ["stats", path]):
        assert run(*line) == 0
    assert cli.main(["demo", "--layout", str(path), "--config.max-steps", "3", "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert all(sign.isprintable() for sign in (said.out + said.err).replace("\n", ""))


def test_the_options_of_a_plan_are_options_of_the_commands(tmp_path: Path, capsys: Said) -> None:
    """Seen: only resolution_m and kind were; an image with grey unknown could not be read as it should."""
    picture, house = plans.save(plans.two_rooms_picture(), tmp_path / "plan.png"), tmp_path / "house.json"
    read = ("convert", picture, house, "--resolution-m", "0.05")
    assert run(*read) == 0
    assert "note: 'plan.png': grey 205 on 25 % of the picture" in capsys.readouterr().err
    assert run(*read, "--free-above", "230", "--no-straighten", "--smallest-room-m2", "2", "--door-depth-m", "0.5") == 0
    said = capsys.readouterr()
    assert "2 rooms, 1 door" in said.out
    assert not said.err
    assert run(*read, "--free-above", "300") == 2
    assert re.search("free_above.*254", capsys.readouterr().err)


def test_a_full_disk_names_the_file_and_leaves_the_old_one(
    tmp_path: Path, capsys: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    target = tmp_path / "x.json"
    target.write_text("old")
    monkeypatch.setattr(Path, "write_text", full)
    assert run("convert", "two_rooms", target) == 2
    assert f"{target}: No space left" in capsys.readouterr().err
    assert target.read_bytes() == b"old"
