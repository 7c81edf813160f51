"""Untrusted files: size, header and contents are checked before anything is decoded."""

from __future__ import annotations

import re
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mecp_env.core.errors import LayoutError
from mecp_env.core.paths import read_bytes
from mecp_env.core.settings import shown

MAX_JSON_BYTES = 2_000_000
MAX_IMAGE_BYTES = 20_000_000
MAX_PIXELS = 4096 * 4096
MAX_PLAIN_PIXELS = 1_000_000  # of an image written in digits, which is slow to read
STRIP_PIXELS = 1_000_000  # of an image that are worked on at once, in up to eight bytes each
MODES = ("1", "L", "LA", "P", "RGB", "RGBA")
FORMATS = ("PNG", "PPM")
PORTABLE_HEADER, COMMENT = 2_000, re.compile(rb"#[^\n]*")  # of PGM; a long one is slow to read
DIGITS = (b"P1", b"P2", b"P3")  # how an image written in digits begins


def read_image(path: Path) -> Image.Image:
    """The decoded image of a PNG or PGM file, in one of `MODES`.

    Raises LayoutError naming what is wrong: bytes, format, pixels or mode out of bounds (before anything is decoded),
    or data that do not fit the header.
    """
    data = read_bytes(path, MAX_IMAGE_BYTES)
    digits = data.startswith(DIGITS)
    if data.startswith(b"P") and len(COMMENT.sub(b"", data[:PORTABLE_HEADER]).split()) < 3:
        raise LayoutError(f"image: the header is longer than {PORTABLE_HEADER} bytes")
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path, formats=FORMATS) as image:
            _check_header(image, MAX_PLAIN_PIXELS if digits else MAX_PIXELS)
            image.load()
            return image.copy()
    except LayoutError:
        raise
    except (UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise LayoutError(f"image: no PNG or PGM of at most {MAX_PIXELS} pixels ({_short(error)})") from None
    except (OSError, ValueError, SyntaxError, EOFError, struct.error, OverflowError, IndexError, KeyError) as error:
        raise LayoutError(f"image: damaged, its data do not fit its header ({_short(error)})") from None


def _short(error: Exception) -> str:
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__


def _check_header(image: Image.Image, most: int) -> None:
    width, height = image.size
    if width * height > most:
        raise LayoutError(f"image: {width} x {height} pixels, at most {most} in all")
    if image.mode not in MODES:
        raise LayoutError(f"image: mode {image.mode}, one of {', '.join(MODES)} (8 bits a channel)")
    if getattr(image, "is_animated", False):
        raise LayoutError("image: animated, one picture expected")


def grey(image: Image.Image) -> tuple[NDArray[np.uint8], NDArray[np.bool_] | None]:
    """Grey levels (h,w) 0-255 of an image, and where (h,w) it is opaque, or None for everywhere."""
    rows = max(1, STRIP_PIXELS // image.width)
    tops = range(0, image.height, rows)
    strips = [_grey(image.crop((0, top, image.width, min(top + rows, image.height)))) for top in tops]
    opaque = [strip for _, strip in strips if strip is not None]
    return np.concatenate([levels for levels, _ in strips]), np.concatenate(opaque) if opaque else None


def _grey(strip: Image.Image) -> tuple[NDArray[np.uint8], NDArray[np.bool_] | None]:
    """As `grey`, of some rows of an image."""
    if strip.mode == "P":
        strip = strip.convert("RGBA" if "transparency" in strip.info else "RGB")
    levels = np.asarray(strip.convert("L"))
    opaque = np.asarray(strip.getchannel("A")) == 255 if strip.mode in ("LA", "RGBA") else None
    return levels, opaque


def require(value: Any, field: str, low: float, high: float) -> float:
    """`value` as a number. Raises LayoutError unless it is one from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise LayoutError(f"{field}: a number from {low:g} to {high:g} expected (given: {shown(value)})")
    return float(value)
