"""Colours shared by frames and figures, as RGB 0..255."""

from __future__ import annotations

RGB = tuple[int, int, int]

PAPER: RGB = (250, 250, 248)
INK: RGB = (38, 44, 54)
MUTED: RGB = (86, 94, 107)  # of text beside what matters more
FAINT: RGB = (118, 125, 136)  # of lines and marks, not of text
SOLID: RGB = (70, 77, 90)
FREE: RGB = (255, 255, 255)
UNSEEN: RGB = (224, 227, 231)
TRUTH: RGB = (120, 126, 136)
ESTIMATE: RGB = (31, 90, 200)
HIT: RGB = (214, 60, 60)
BEAM: RGB = (120, 170, 240)
LANDMARK: RGB = (176, 24, 48)
MOVER: RGB = (120, 70, 160)
POLYGON: RGB = (194, 24, 122)
DOOR: RGB = (224, 140, 0)
GOAL: RGB = (20, 140, 90)
PLACE: RGB = (120, 100, 190)

ROOMS: tuple[RGB, ...] = (
    (76, 120, 168),
    (84, 162, 75),
    (178, 105, 162),
    (228, 130, 50),
    (70, 175, 170),
    (200, 80, 90),
    (150, 118, 90),
    (205, 175, 45),
    (110, 100, 190),
    (235, 140, 160),
    (105, 140, 60),
    (90, 105, 120),
)


# Okabe and Ito's colours, which the colour-blind can tell apart, the darkest first; lines have a marker and dashes too.
SERIES: tuple[RGB, ...] = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (38, 44, 54),
    (230, 159, 0),
    (86, 180, 233),
)
MARKERS = "osD^vPX"


def room_colour(room: int) -> RGB:
    """The colour of a room id; grey where the room is not known."""
    return ROOMS[room % len(ROOMS)] if room >= 0 else FAINT


def mix(colour: RGB, other: RGB, share: float) -> RGB:
    """`colour` with `share` (0..1) of `other` in it."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(colour, other, strict=True))
    return red, green, blue


def unit(colour: RGB) -> tuple[float, float, float]:
    """The colour as matplotlib wants it, 0..1."""
    return colour[0] / 255, colour[1] / 255, colour[2] / 255
