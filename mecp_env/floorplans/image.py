"""Images: untrusted ones are checked before they are decoded; of plain ones the bright pixels are floor.

Of labelled ones black is wall, white a closed door, every other colour a room. Whether an image file holds what its
header says is checked here: Pillow fills up what is missing and ignores what is left.
"""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image, ImageOps
from PIL.ImageFile import ImageFile
from scipy import ndimage
from shapely.geometry import Point

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.errors import LayoutError, PlanWarning
from mecp_env.core.files import exists, read_bytes
from mecp_env.floorplans.foreign import by_start
from mecp_env.floorplans.options import Crossing, FreeSpace, PlanOptions
from mecp_env.floorplans.vectorise import MAX_CELLS, Placement, floor_polygon

CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # of each colour type of PNG
ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
SIGNATURE = 8  # bytes
AFTER_PGM = 2  # bytes that may follow the pixels, a line end
RAW = {b"P4": 1, b"P5": 8, b"P6": 24}  # bits per pixel


def check_content(data: bytes, image: ImageFile) -> None:
    """Raise LayoutError where `data` holds fewer or more pixels than the header of `image`, or a damaged chunk."""
    if image.format == "PNG":
        _check_png(data)
    elif data[:2] in RAW and image.tile:
        width, height = image.size
        given = len(data) - int(image.tile[0][2])
        expected = height * ((width * RAW[data[:2]] + 7) // 8)
        _require(given, expected, AFTER_PGM, image.size)


def _check_png(data: bytes) -> None:
    chunks = list(_chunks(data))
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", chunks[0][1][:13])
    bits = CHANNELS[colour] * depth
    passes = ADAM7 if interlaced else ((0, 0, 1, 1),)
    sizes = [(-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in passes]
    expected = sum(rows * (1 + (columns * bits + 7) // 8) for columns, rows in sizes if rows > 0 and columns > 0)
    pixels = zlib.decompressobj().decompress(b"".join(body for kind, body in chunks if kind == b"IDAT"), expected + 1)
    _require(len(pixels), expected, 0, (width, height))


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Type and content of each chunk of a PNG. Raises LayoutError for a damaged one, and without the last one."""
    at = SIGNATURE
    while at + 12 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        body, checksum = data[at + 4 : at + 8 + length], data[at + 8 + length : at + 12 + length]
        if checksum != struct.pack(">I", zlib.crc32(body)):
            raise LayoutError(f"damaged: wrong checksum of the chunk {body[:4]!r} at byte {at}")
        yield body[:4], body[4:]
        at += 12 + length
        if body[:4] == b"IEND":
            return
    raise LayoutError(f"truncated: {len(data)} bytes without the chunk IEND")


def _require(given: int, expected: int, more: int, size: tuple[int, int]) -> None:
    if not expected <= given <= expected + more:
        amount = f"{given}" if given <= expected else f"more than {expected}"
        raise LayoutError(f"{amount} bytes of pixels, {expected} expected by its header ({size[0]} x {size[1]} pixels)")


MAX_IMAGE_BYTES = 20_000_000
MAX_PIXELS = 4096 * 4096
MAX_PLAIN_PIXELS = 1_000_000  # of an image written in digits, which is slow to read
UNKNOWN_SHARE, APART = 0.02, 25  # of the pixels that a grey level has, so far from others, to mean something of its own
MODES = ("1", "L", "LA", "P", "RGB", "RGBA")
KNOWN = "PNG, PGM, BMP or TIFF"
FORMATS = ("PNG", "PPM", "BMP", "TIFF")
LEAST_ALPHA = 128  # a pixel that is less than half opaque shows nothing
DARK = 128  # of 255: what is drawn in a level below is wall
DIGITS = (b"P1", b"P2", b"P3")  # how an image written in digits begins
DAMAGE = (OSError, ValueError, SyntaxError, struct.error, OverflowError, LookupError, TypeError, EOFError, zlib.error)
SMALLER = "scale it down, and give the metres per pixel of the smaller one"


def read_image(path: Path) -> Image.Image:
    """The decoded image of a PNG, PGM, BMP or TIFF file, in one of `MODES`.

    Raises LayoutError naming what is wrong: bytes, format, pixels or mode out of bounds (before anything is decoded),
    or data that do not fit the header.
    """
    try:
        data = read_bytes(path, MAX_IMAGE_BYTES)
        if foreign := by_start(data):
            raise LayoutError(foreign)
        most = MAX_PLAIN_PIXELS if data.startswith(DIGITS) else MAX_PIXELS
        with warnings.catch_warnings(action="ignore"), Image.open(BytesIO(data), formats=FORMATS) as image:
            _check_header(image, most)
            check_content(data, image)
            several = getattr(image, "is_animated", False)
            image.load()
            ImageOps.exif_transpose(image, in_place=True)  # as every viewer shows it
    except LayoutError as error:
        raise LayoutError(f"image: {path.name!r:.80}: {error}") from None
    except Image.DecompressionBombError:
        raise LayoutError(
            f"image: {path.name!r:.80}: too large, at most {MAX_PIXELS} pixels in all; {SMALLER}"
        ) from None
    except DAMAGE as error:
        said = f"damaged, or no {KNOWN} of at most {MAX_PIXELS} pixels ({str(error).partition(' <')[0]:.120})"
        raise LayoutError(f"image: {path.name!r:.80}: {said}") from None
    if several:
        warnings.warn(f"image: {path.name!r:.80}: of several pictures the first is read", PlanWarning, stacklevel=4)
    return image


def _check_header(image: Image.Image, most: int) -> None:
    width, height = image.size
    if width * height > most:
        raise LayoutError(f"{width} x {height} pixels, at most {most} in all; {SMALLER}")
    if image.mode not in MODES:
        raise LayoutError(f"mode {image.mode}, one of {', '.join(MODES)}; save it as grey or RGB of 8 bits per channel")


def grey(image: Image.Image) -> tuple[NDArray[np.uint8], Bools]:
    """Grey levels (h,w) 0-255 of an image, and where (h,w) it is more opaque than not."""
    if image.mode == "P" or "transparency" in image.info:
        image = image.convert("RGBA" if "transparency" in image.info else "RGB")
    alpha = image.getchannel("A") if "A" in image.mode else None
    image = image if image.mode == "L" else image.convert("L")  # the colours of a large image go first
    opaque = np.ones(image.size[::-1], np.bool_) if alpha is None else np.asarray(alpha) >= LEAST_ALPHA
    return np.asarray(image), opaque


def read_plain_image(path: Path, options: PlanOptions) -> FreeSpace:
    """The floor of an image whose pixels have `options.resolution_m`, brighter than `options.free_above`."""
    if options.resolution_m is None:
        sheet = path.with_suffix(".yaml")
        beside = f" ({sheet.name} lies beside it)" if exists(sheet) else ""
        raise LayoutError(f"resolution_m: missing, metres per pixel; give it, or name a map_server yaml{beside}")
    levels, opaque = grey(read_image(path))
    threshold = _threshold(levels, opaque) if options.free_above is None else options.free_above
    placement = Placement(options.resolution_m)
    between = "" if options.free_above is not None else _grey_between(shares(levels, opaque), threshold)
    floor = levels > threshold
    floor &= opaque
    del levels, opaque  # of large images
    area = floor_polygon(floor, placement, told=bool(between))
    if between:
        warnings.warn(f"{path.name!r:.80}: {between}; free_above decides", PlanWarning, stacklevel=2)
    note = f"From {path.name}: {options.resolution_m:g} m per pixel, floor where brighter than {threshold}."
    return FreeSpace(path.stem, f"{note} {between[:1].upper()}{between[1:]}".strip(), area, placement.noise_m)


def _threshold(levels: NDArray[np.uint8], opaque: Bools) -> int:
    """The grey level above which pixels are floor; of one bright colour on a transparent ground, that colour is."""
    level = int(levels[0, 0])
    if opaque.any() and not opaque.all() and (levels == level).all():
        if level < DARK:
            raise LayoutError("image: all of it is dark, on a transparent ground: save it on a white one")
        return level - 1
    return otsu(levels)


def shares(levels: NDArray[np.uint8], opaque: Bools) -> Array:
    """(256,) the share of each grey level in the opaque pixels; 0 without any. NumPy would count in 8 bytes a pixel."""
    counts = np.array(Image.fromarray(levels).histogram(Image.fromarray(opaque.view(np.uint8))), np.float64)
    share: Array = counts / max(1.0, counts.sum())
    return share


def _grey_between(share: Array, threshold: int) -> str:
    """What a common grey level between those of wall and floor is read as, in words; empty if there is none."""
    likely = [int(level) for level in np.flatnonzero(share >= UNKNOWN_SHARE)]
    common = [level for level in likely if share[level] == share[max(0, level - APART + 1) : level + APART].max()]
    middle = [level for level in common if common[0] + APART < level < common[-1] - APART]
    if not middle:
        return ""
    level = max(middle, key=lambda level: float(share[level]))
    meaning = f"floor, being above {threshold}" if level > threshold else f"wall, not being above {threshold}"
    return f"grey {level} on {100.0 * share[level]:.0f} % of the picture, between wall and floor, is read as {meaning}"


def otsu(levels: NDArray[np.uint8]) -> int:
    """The grey level that separates dark from bright best (Otsu 1979): greatest variance between both."""
    counts = np.array(Image.fromarray(levels).histogram(), np.float64)
    below = np.cumsum(counts)
    sums = np.cumsum(counts * np.arange(256))
    above = below[-1] - below
    with np.errstate(invalid="ignore", divide="ignore"):
        between = below * above * (sums / below - (sums[-1] - sums) / above) ** 2
    if not np.isfinite(between).any():
        raise LayoutError("image: all its pixels have one grey level; free_above decides whether it is floor")
    return int(np.nanargmax(between))


MAX_PARTS = 2_000  # rooms, or doors, of an image
MAX_SPREAD = 20_000_000  # pixels in the boxes around each colour
SMALLEST_CELLS = 12  # a patch of fewer pixels is the blurred edge of another

OPAQUE, BLACK, WHITE = 0xFF000000, 0xFF000000, 0xFFFFFFFF
Labels = NDArray[np.int32]
DOWNWARDS = np.array([1.0, -1.0])  # rows are counted from above
WALL, DOOR = 0, 1  # rooms are 2, 3, ...


def read_labelled_image(path: Path, options: PlanOptions) -> FreeSpace:
    """The floor of a labelled image, its rooms, and its doors: white patches that part two rooms.

    Raises LayoutError where two rooms touch without a door, and for a door that does not join two rooms.
    """
    if options.resolution_m is None:
        raise LayoutError("resolution_m: missing, metres per pixel")
    image = read_image(path)
    if image.width * image.height > MAX_CELLS:
        raise LayoutError(f"image: {image.width} x {image.height} pixels, at most {MAX_CELLS} with labels")
    labels = _labels(image)
    _check_closed(labels)
    placement = Placement(options.resolution_m)
    area = floor_polygon(labels != WALL, placement, told=True)  # every room is required
    note = f"From {path.name}, labelled: {options.resolution_m:g} m per pixel."
    crossings, drawn = _crossings(labels, placement), _drawn(labels, placement)
    return FreeSpace(path.stem, note, area, placement.noise_m, crossings=crossings, drawn=drawn)


def _labels(image: Image.Image) -> Labels:
    """The label (h,w) of each pixel; patches of one colour that do not touch are two rooms."""
    image = image.convert("RGBA")
    if image.getcolors(MAX_PARTS) is None:
        raise LayoutError(f"image: more than {MAX_PARTS} colours; save it without blur or compression")
    colour = np.array(image).view("<u4")[..., 0]  # red in the lowest byte, opacity in the highest
    colour[colour < OPAQUE] = BLACK
    values, index = np.unique(colour, return_inverse=True)
    labels = np.where(colour == WHITE, DOOR, WALL).astype(np.int32)
    is_room = (values != BLACK) & (values != WHITE)
    codes = np.where(is_room, np.arange(1, len(values) + 1), 0).astype(np.int32)[index.reshape(colour.shape)]
    places = [(code, place) for code, place in enumerate(ndimage.find_objects(codes), 1) if place is not None]
    if sum(labels[place].size for _, place in places) > MAX_SPREAD:
        raise LayoutError(f"image: {len(places)} colours overlap; save it without blur or compression")
    last = DOOR
    for code, place in places:
        last = _number_patches(labels[place], codes[place] == code, last)
    return labels


def _number_patches(labels: Labels, here: NDArray[np.bool_], last: int) -> int:
    """The last number given: each patch of `here` (h,w) gets one above `last`, in place; small patches stay walls."""
    patches, _ = ndimage.label(here)
    sizes = np.bincount(patches.ravel())
    sizes[0] = 0
    large = sizes >= SMALLEST_CELLS
    if last + large.sum() > MAX_PARTS:
        raise LayoutError(f"image: more than {MAX_PARTS} rooms")
    number = np.where(large, last + np.cumsum(large), WALL)
    labels[here] = number[patches[here]]
    return int(last + large.sum())


def _check_closed(labels: Labels) -> None:
    """Rooms touch no other room."""
    for first, second in ((labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])):
        open_edge = (first > DOOR) & (second > DOOR) & (first != second)
        if open_edge.any():
            row, column = np.argwhere(open_edge)[0].tolist()
            raise LayoutError(f"image: two rooms touch at column {column}, row {row}; close them by a white door line")


def _crossings(labels: Labels, placement: Placement) -> tuple[Crossing, ...]:
    doors, count = ndimage.label(labels == DOOR, structure=np.ones((3, 3)))
    if count > MAX_PARTS:
        raise LayoutError(f"image: {count} doors, at most {MAX_PARTS}")
    found: list[Any] = [_crossing(labels, doors, i, place) for i, place in enumerate(ndimage.find_objects(doors), 1)]
    return tuple(Crossing(_in_world(middle[None], labels, placement)[0], along * DOWNWARDS) for middle, along in found)


def _in_world(pixels: Array, labels: Labels, placement: Placement) -> Array:
    """Points (n,2), m, of the middles of pixels (n,2), column and row from above."""
    return placement.to_world(pixels * DOWNWARDS + (0.5, len(labels) - 0.5))


def _drawn(labels: Labels, placement: Placement) -> tuple[tuple[str, Point], ...]:
    """Each room: the pixel that is furthest from its edges, and the point there."""
    inside = np.pad(labels > DOOR, 1)
    depth = ndimage.distance_transform_cdt(inside, "chessboard")[1:-1, 1:-1]
    deepest = np.zeros(int(labels.max()) + 1, np.int32)
    np.maximum.at(deepest, labels, depth)
    rows, columns = np.nonzero((depth > 0) & (depth == deepest[labels]))
    _, first = np.unique(labels[rows, columns], return_index=True)
    pixels = np.stack([columns[first], rows[first]], axis=1)
    points = shapely.points(_in_world(pixels.astype(np.float64), labels, placement))
    return tuple((f"column {x}, row {y}", point) for (x, y), point in zip(pixels.tolist(), points, strict=True))


def _crossing(labels: Labels, doors: Any, index: int, place: Any) -> tuple[Any, Any]:
    """Middle and direction, column and row, of a door: along the edges that it shares with its two rooms."""
    top, left = max(place[0].start - 1, 0), max(place[1].start - 1, 0)
    window = np.s_[top : place[0].stop + 1, left : place[1].stop + 1]
    beside = ndimage.binary_dilation(doors[window] == index, np.ones((3, 3), dtype=np.bool_)) & (labels[window] > DOOR)
    rooms = np.unique(labels[window][beside])
    if len(rooms) != 2:
        raise LayoutError(f"image: the door at column {left + 1}, row {top + 1} joins {len(rooms)} rooms, 2 expected")
    edges = [np.argwhere(beside & (labels[window] == room))[:, ::-1].astype(np.float64) for room in rooms]
    spread = np.concatenate([edge - edge.mean(axis=0) for edge in edges])
    along = np.linalg.eigh(spread.T @ spread)[1][:, -1]
    return (edges[0].mean(axis=0) + edges[1].mean(axis=0)) / 2.0 + (left, top), along
