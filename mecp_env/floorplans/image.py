"""Images: untrusted ones are checked before they are decoded; of plain ones the bright pixels are floor.

Whether an image file holds what its header says; Pillow fills up what is missing and ignores what is left.
"""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from PIL.ImageFile import ImageFile

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.errors import LayoutError, PlanWarning
from mecp_env.core.files import exists, read_bytes
from mecp_env.floorplans.foreign import by_start
from mecp_env.floorplans.options import FreeSpace, PlanOptions
from mecp_env.floorplans.vectorise import Placement, floor_polygon

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
DAMAGE = (
    OSError,
    ValueError,
    SyntaxError,
    struct.error,
    OverflowError,
    LookupError,
    TypeError,
    EOFError,
    zlib.error,
)
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
