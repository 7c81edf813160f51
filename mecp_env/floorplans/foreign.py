"""What a file is that is no plan, in a sentence: foreign kinds of buildings, and other yaml and JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml

from mecp_env.core.errors import LayoutError
from mecp_env.core.files import read_bytes

SUPPORTED = "read are our JSON, HouseExpo JSON, map_server yaml with its image, PNG, PGM, BMP and TIFF"
DRAW = "export it as a PNG with white floor and black walls, and read that with --resolution-m"
OTHER_JSON = f"JSON of another kind; {SUPPORTED}: {DRAW}"
AS_PNG = "save it as a PNG, and read that with --resolution-m"
UNPACK = "unpack it, and name the plan in it, or the folder"
MAP = "map it with mecp-env slam, whose folder has the map as yaml and picture"
SAVE = "map it, or slice it at the height of the laser, and save that with map_saver as yaml and pgm"
BY_ENDING = {
    ".dxf": ("a CAD drawing (DXF)", DRAW),
    ".dwg": ("a CAD drawing (DWG)", DRAW),
    ".ifc": ("a building information model (IFC)", f"cut a floor out of it, then {DRAW}"),
    ".geojson": ("GeoJSON", DRAW),
    ".osm": ("an OpenStreetMap extract", DRAW),
    ".svg": ("an SVG drawing, as the floor plans of CubiCasa5K", DRAW),
    ".pdf": ("a PDF document", DRAW),
    **dict.fromkeys((".jpg", ".jpeg"), ("a JPEG picture, whose compression blurs walls", AS_PNG)),
    ".webp": ("a WebP picture", AS_PNG),
    ".gif": ("a GIF picture", AS_PNG),
    ".zip": ("a packed archive", UNPACK),
    **dict.fromkeys((".gz", ".tgz", ".tar", ".7z", ".rar", ".bz2", ".xz", ".zst"), ("a packed file", UNPACK)),
    ".bag": ("a recording of ROS", MAP),
    **dict.fromkeys((".db3", ".mcap"), ("a recording of ROS 2", MAP)),
    ".world": ("a world of Gazebo or Stage", SAVE),
    ".sdf": ("a world or model of Gazebo (SDF)", SAVE),
    ".urdf": ("a robot or scene description (URDF)", SAVE),
    ".xml": ("XML of a simulator", SAVE),
    ".wbt": ("a world of Webots", SAVE),
    ".pbstream": ("a map of Cartographer", "write it with cartographer_pbstream_to_ros_map as yaml and pgm"),
    ".posegraph": ("a map of slam_toolbox", "save it with map_saver as yaml and pgm"),
    ".lfs": ("a pointer of Git LFS in place of the file", "fetch the file with git lfs pull"),
}
BY_START = {  # bytes that a file begins with: the ending of its kind
    b"\xff\xd8\xff": ".jpg",
    b"RIFF": ".webp",
    b"GIF8": ".gif",
    b"PK\x03\x04": ".zip",
    b"\x1f\x8b": ".gz",
    b"%PDF": ".pdf",
    b"<svg": ".svg",
    b"<?xml": ".svg",
    b"version https://git-lfs": ".lfs",
    b"AC10": ".dwg",
}
GEOJSON_FIELDS = {"features", "geometry", "geometries", "coordinates"}
MAP_FIELDS = ("image", "resolution", "origin")
PLAN_FIELDS = {"verts", "solids", "rooms", "starts"}  # JSON with one of them is meant to be a plan
MAX_READ = 2_000_000  # bytes


def by_ending(path: Path) -> str:
    """What a file is by its ending, what is read instead, and how to convert it."""
    if path.suffix.lower() in BY_ENDING:
        return _sentence(*BY_ENDING[path.suffix.lower()])
    return f"no plan by its ending, {path.suffix!r:.80}; {SUPPORTED}: {DRAW}; or, of a simulator, {SAVE}"


def by_start(data: bytes) -> str:
    """What a file is by its first bytes, and how to convert it; empty for others."""
    ending = next((ending for start, ending in BY_START.items() if data.startswith(start)), "")
    return _sentence(*BY_ENDING[ending]) if ending else ""


def _sentence(what: str, remedy: str) -> str:
    return f"this is {what}; {SUPPORTED}: {remedy}"


def of_json(document: Any) -> str:
    """What a JSON document is that is neither a layout nor of HouseExpo, in a sentence; empty where it may be one."""
    if not isinstance(document, dict):
        return OTHER_JSON
    if "type" in document and document.keys() & GEOJSON_FIELDS:
        return _sentence("GeoJSON", DRAW)
    if "proceduralParameters" in document or {"walls", "objects", "rooms"} <= document.keys():
        return _sentence("a house of ProcTHOR", SAVE)
    if document.keys() & PLAN_FIELDS:
        return ""
    return OTHER_JSON


def of_yaml(fields: Any) -> str:
    """What a yaml document is that is no map, in a sentence; empty where it has a field of a map."""
    if isinstance(fields, dict) and "levels" in fields and "image" not in fields:
        return _sentence("a building of RMF (building.yaml)", f"take the drawing it names, or {DRAW}")
    missing = [field for field in MAP_FIELDS if not isinstance(fields, dict) or field not in fields]
    return f"yaml without {', '.join(missing)}, which no map is" if missing else ""


def why_no_plan(path: Path) -> str:
    """Why a JSON or yaml file in a folder is no plan; empty for one that is, or means to be."""
    is_json = path.suffix.lower() == ".json"
    try:
        data = read_bytes(path, MAX_READ)
    except LayoutError as error:
        return "" if path.is_symlink() else str(error)
    try:
        return of_json(json.loads(data)) if is_json else of_yaml(yaml.safe_load(data))
    except (ValueError, yaml.YAMLError, RecursionError, TypeError):
        is_meant = is_json or (b"image:" in data and b"resolution:" in data)
        return "" if is_meant else "damaged, and without the fields of a plan"
