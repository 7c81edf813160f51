"""Frames of an episode: ground truth at the left, the estimate at the right, figures above, a legend below.

A film of them as a GIF of bounded length and size.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter

from mecp_env.core.carriers import Array, Bytes
from mecp_env.core.se2 import compose, inverse, to_map
from mecp_env.render import palette, shapes
from mecp_env.render.brush import Box, Brush, Camera
from mecp_env.render.palette import RGB
from mecp_env.render.shapes import KNOWN_GROUND, SceneView, loops, magnification, signed_area, summary
from mecp_env.slam.messages import Cell, SemanticGrid

OCCUPIED = int(Cell.OCCUPIED)
WALL = 0.22  # of the smoothed walls: those of one cell keep about its width
MARGIN, HEADER, FOOTER = 12, 58, 28
SMALL_MARGIN, SMALL_HEADER = 8, 44  # of a thumbnail
Legend = tuple[tuple[str, palette.RGB, str], ...]
LEGEND: Legend = (
    ("true path", palette.TRUTH, "line"),
    ("laser hit", palette.HIT, "dot"),
    ("estimated path", palette.ESTIMATE, "line"),
    ("recognised polygon", palette.POLYGON, "line"),
    ("door", palette.DOOR, "line"),
    ("goal", palette.GOAL, "dot"),
    ("room: one colour each", palette.ROOMS[0], "dot"),
)
PLACE_LEGEND: Legend = (("known ground", palette.PLACE, "square"),)
MAP_LEGEND: Legend = (
    ("estimated path", palette.ESTIMATE, "line"),
    ("door", palette.DOOR, "line"),
    ("polygons of a room: one colour each", palette.ROOMS[0], "dot"),
)
BARS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
HEADER_LETTERS = 2500.0  # a title of more letters is written smaller than 24 px
COLOURS = 96
SMALL = (palette.HIT, palette.LANDMARK, palette.GOAL, palette.DOOR, palette.ESTIMATE, palette.TRUTH, palette.INK)
LAST_FRAME_MS = 2500


def draw_world(brush: Brush, view: SceneView, box: Box) -> None:
    """The true walls, the robot with its scan, and its path."""
    camera = Camera.fit(view.bounds, box)
    _draw_walls(brush, view, camera, palette.SOLID)
    ends, hit = shapes.beam_ends(view.slam_output, view.T_world_robot)
    brush.veil([(camera.pixels(shapes.beam_fan(view.slam_output, view.T_world_robot)), palette.BEAM)], alpha=50)
    brush.line(camera.pixels(view.path_world), palette.TRUTH, 1.5)
    for pixel in camera.pixels(ends[hit]):
        brush.dot(pixel, 1.3, palette.HIT)
    _draw_moving(brush, view, camera)
    draw_robot(brush, view.T_world_robot, view.robot_radius_m, camera, palette.INK)


def draw_nothing(brush: Brush, view: SceneView, box: Box) -> None:
    """An empty half in the place of the world."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [box.width, box.height] + np.array([box.left, box.top])
    brush.area(corners, palette.UNSEEN)
    brush.text("hidden", (box.middle[0], box.middle[1] - 10), 28, palette.MUTED, align=0.5)


def draw_belief(brush: Brush, view: SceneView, box: Box) -> None:
    """Grid, polygons, doors, landmarks, goals, the estimated path and pose, laid over the place of the world."""
    camera = Camera.fit(view.bounds, box)
    brush.picture(grid_picture(view.slam_output.grid, view.T_world_map, camera, box), box)
    _draw_map(brush, view, camera)
    brush.line(camera.pixels(view.to_world(view.path_map)), palette.ESTIMATE, 1.5)
    polygon, vertices = shapes.recognised(view)
    if len(polygon):
        brush.ring(camera.pixels(polygon), palette.POLYGON, 2.5)
    for pixel in camera.pixels(vertices):
        brush.square(pixel, 5.0, palette.POLYGON, 1.5)
    _draw_landmarks(brush, view, camera)
    _draw_goals(brush, view, camera)
    _name_rooms(brush, view, camera)
    belief = view.slam_output.belief
    ring = shapes.ellipse(belief.T_map_robot[:2], belief.pose_cov[:2, :2], shapes.magnification(belief))
    brush.ring(camera.pixels(view.to_world(ring)), palette.LANDMARK)
    T_world_robot = compose(view.T_world_map, belief.T_map_robot)
    draw_robot(brush, T_world_robot, view.robot_radius_m, camera, palette.ESTIMATE)


def draw_scan(brush: Brush, view: SceneView, box: Box) -> None:
    """Where the beams of the scan end, by the estimated pose, over what the robot believes."""
    camera = Camera.fit(view.bounds, box)
    ends, hit = shapes.beam_ends(view.slam_output, compose(view.T_world_map, view.slam_output.belief.T_map_robot))
    for pixel in camera.pixels(ends[hit]):
        brush.dot(pixel, 1.3, palette.HIT)


def draw_robot(brush: Brush, T_world_robot: Array, radius_m: float, camera: Camera, colour: RGB) -> None:
    """A disc with a line towards where it looks."""
    x, y, heading = T_world_robot
    nose = [x + radius_m * math.cos(heading), y + radius_m * math.sin(heading)]
    pixels = camera.pixels(np.array([[x, y], nose]))
    brush.dot(pixels[0], max(camera.scale * radius_m, 4.0), colour)
    brush.line(pixels, palette.FREE, 2.0)


def grid_picture(grid: SemanticGrid, T_world_map: Array, camera: Camera, box: Box) -> Bytes:
    """The semantic grid as seen by the camera, one colour per room, uint8 (box height, box width, 3).

    Walls are smooth: cells, whose sides are seldom parallel to the picture's, would be teeth of a saw.
    """
    wall = gaussian_filter((grid.label == OCCUPIED).astype(float), 0.8)
    colours, by_wall = shapes.cell_colours(grid, walls=False), maximum_filter(wall, 3) > 0.99 * WALL
    x, y = camera.pixel_centres(box)
    p_world = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1).reshape(-1, 2)
    p_map = to_map(inverse(T_world_map), p_world)
    across, up = ((p_map[:, i] - grid.origin[i]) / grid.resolution_m for i in (0, 1))  # by column: fast
    cols, rows = np.floor(across).astype(np.int64), np.floor(up).astype(np.int64)
    inside = np.flatnonzero((rows >= 0) & (rows < wall.shape[0]) & (cols >= 0) & (cols < wall.shape[1]))
    cells = rows[inside], cols[inside]
    picture = np.full((len(p_map), 3), palette.UNSEEN, np.uint8)
    picture[inside] = colours[cells]
    near = inside[by_wall[cells]]
    picture[near[map_coordinates(wall, np.stack([up[near], across[near]]) - 0.5, order=1) > WALL]] = palette.SOLID
    return picture.reshape(box.height, box.width, 3)


def _draw_walls(brush: Brush, view: SceneView, camera: Camera, colour: RGB) -> None:
    """The true walls, and free space between them."""
    for strip in shapes.wall_strips(view.segments):
        brush.area(camera.pixels(strip), colour)
    for ring in loops(view.segments):
        brush.area(camera.pixels(ring), colour if signed_area(ring) < 0.0 else palette.FREE)


def _draw_moving(brush: Brush, view: SceneView, camera: Camera) -> None:
    for ring in loops(view.moving):
        brush.area(camera.pixels(ring), palette.MOVER)


def _draw_landmarks(brush: Brush, view: SceneView, camera: Camera) -> None:
    for ring in shapes.landmark_ellipses(view):
        brush.ring(camera.pixels(ring), palette.LANDMARK)
    for pixel in camera.pixels(view.to_world(view.slam_output.belief.p_map)):
        brush.dot(pixel, 2.2, palette.LANDMARK)


def _name_rooms(brush: Brush, view: SceneView, camera: Camera) -> None:
    for room, p_map in shapes.room_labels(view.slam_output, view.path_map).items():
        brush.label(f"room {room}", camera.pixels(view.to_world(p_map[None]))[0], 18)


def _draw_map(brush: Brush, view: SceneView, camera: Camera) -> None:
    """Polygons of the rooms, doors and door candidates."""
    areas = [(camera.pixels(ring), colour) for ring, colour in shapes.polygon_rings(view)]
    brush.veil(areas, alpha=60)
    for pixels, colour in areas:
        brush.ring(pixels, palette.mix(colour, palette.FREE, 0.45))
    faces, candidates = shapes.door_lines(view)
    for face in faces:
        brush.line(camera.pixels(face), palette.DOOR, 3.0)
    for start, end in map(camera.pixels, candidates):
        brush.dashes(start, end, palette.DOOR)


def _draw_goals(brush: Brush, view: SceneView, camera: Camera) -> None:
    """Circles for what is left to see, squares for known ground; the chosen goal is full."""
    for index, pixel in enumerate(camera.pixels(view.to_world(view.p_goals))):
        chosen = index == view.target
        radius, width = (6.0, 0.0) if chosen else (4.0, 1.5)
        if view.goal_kinds[index] >= KNOWN_GROUND:
            brush.square(pixel, radius, palette.PLACE, width)
        else:
            brush.dot(pixel, radius, palette.GOAL, width)


class Screen:
    """Draws frames of one size, px; touches no display (the window of the `human` mode is in window.py)."""

    def __init__(self, width: int = 1200, height: int = 520) -> None:
        self.width, self.height = width, height

    @classmethod
    def around(cls, bounds: Array, width: int) -> Screen:
        """As high as a building with these `bounds` (2,2) m fills both halves, within what fits a screen."""
        across, up = np.maximum(bounds[1] - bounds[0], 1.0).tolist()
        half = (width - 3 * MARGIN) / 2
        height = HEADER + FOOTER + round(min(max(half * up / across, 0.4 * half), 1.4 * half))
        return cls(width, height + height % 2)

    def frame(self, view: SceneView, hide_world: bool = False) -> Bytes:
        """The picture of one moment, uint8 (height, width, 3); the world can be left out."""
        brush = Brush((self.width, self.height), palette.PAPER)
        world, belief = self._panels()
        with brush.inside(world):
            (draw_nothing if hide_world else draw_world)(brush, view, world)
        with brush.inside(belief):
            draw_belief(brush, view, belief)
        brush.text("The world: true walls, robot and scan", (world.left, 36), 18, palette.MUTED)
        brush.text("The belief: what the agent is given", (belief.left, 36), 18, palette.MUTED)
        _draw_header(brush, view)
        places = PLACE_LEGEND if (view.goal_kinds >= KNOWN_GROUND).any() else ()
        _draw_legend(brush, (*LEGEND, _ellipses(view), *places, *_movers(view)))
        return brush.image()

    def _panels(self) -> tuple[Box, Box]:
        width = (self.width - 3 * MARGIN) // 2
        height = self.height - HEADER - FOOTER
        return Box(MARGIN, HEADER, width, height), Box(2 * MARGIN + width, HEADER, width, height)


def map_picture(view: SceneView, width: int = 1200) -> Bytes:
    """The map at the end of an episode: polygons, doors, landmarks and both paths, over the truth or the mapped walls.

    Uint8 (height, width, 3), twice as fine as a frame.
    """
    across, up = np.maximum(view.bounds[1] - view.bounds[0], 1.0).tolist()
    box = Box(MARGIN, HEADER, width - 2 * MARGIN, round((width - 2 * MARGIN) * min(max(up / across, 0.3), 1.4)))
    brush, camera = Brush((width, HEADER + box.height + FOOTER), palette.PAPER), Camera.fit(view.bounds, box)
    known = len(view.segments) > 0
    with brush.inside(box):
        if known:
            _draw_walls(brush, view, camera, palette.TRUE_WALL)
        else:
            brush.picture(grid_picture(view.slam_output.grid, view.T_world_map, camera, box), box)
        _draw_moving(brush, view, camera)
        _draw_map(brush, view, camera)
        brush.line(camera.pixels(view.path_world), palette.TRUE_PATH, 5.0)
        brush.line(camera.pixels(view.to_world(view.path_map)), palette.ESTIMATE, 1.5)
        _draw_landmarks(brush, view, camera)
        _name_rooms(brush, view, camera)
    _draw_header(brush, view)
    _draw_scale(brush, camera.scale)
    truth = (("true walls", palette.TRUE_WALL, "dot"), ("true path", palette.TRUE_PATH, "line"))
    path = (("reference path", palette.TRUE_PATH, "line"),) if len(view.path_world) else ()
    _draw_legend(brush, (*(truth if known else path), *MAP_LEGEND, _ellipses(view), *_movers(view)))
    return brush.image(fine=True)


def _draw_scale(brush: Brush, scale: float) -> None:
    """A bar at the lower right corner, at most a quarter of the picture long."""
    length = max((bar for bar in BARS_M if 4.0 * scale * bar <= brush.size[0]), default=BARS_M[0])
    right, y = brush.size[0] - MARGIN, brush.size[1] - FOOTER + 12
    brush.line(np.array([[right - scale * length, y], [right, y]]), palette.INK, 2.5)
    brush.text(f"{length:g} m", (right - scale * length - 6, y - 6), 18, align=1.0)


def _draw_header(brush: Brush, view: SceneView) -> None:
    size = min(24, max(14, round(HEADER_LETTERS / max(len(view.title), 1))))
    brush.text(view.title, (MARGIN, 10), size)
    x = float(brush.size[0] - MARGIN)
    for name, value in reversed(summary(view.metrics)):
        x -= brush.text(value, (x, 11), 22, align=1.0) + 5
        x -= brush.text(name, (x, 13), 18, palette.MUTED, align=1.0) + 16


def _draw_legend(brush: Brush, legend: Legend) -> None:
    x, y = float(MARGIN), brush.size[1] - FOOTER + 6
    for name, colour, kind in legend:
        if kind == "dot":
            brush.dot((x + 6, y + 6), 3.5, colour)
        elif kind == "square":
            brush.square((x + 6, y + 6), 4.0, colour, 1.5)
        else:
            brush.line(np.array([[x, y + 6], [x + 12, y + 6]]), colour, 2.5)
        x += 18 + brush.text(name, (x + 18, y), 16, palette.MUTED) + 18


def _ellipses(view: SceneView) -> tuple[str, RGB, str]:
    return f"landmark, 95 % ellipse x {magnification(view.slam_output.belief):.0f}", palette.LANDMARK, "dot"


def _movers(view: SceneView) -> Legend:
    return (("pedestrian, box", palette.MOVER, "square"),) if len(view.moving) else ()


def thumbnail(view: SceneView, size: tuple[int, int], title: str, caption: str, scan: bool = False) -> Bytes:
    """What the robot believes at one moment, uint8 (height, width, 3); `size` is width and height, px."""
    brush = Brush(size, palette.PAPER)
    box = Box(SMALL_MARGIN, SMALL_HEADER, size[0] - 2 * SMALL_MARGIN, size[1] - SMALL_HEADER - SMALL_MARGIN)
    with brush.inside(box):
        draw_belief(brush, view, box)
        if scan:
            draw_scan(brush, view, box)
    brush.text(title, (SMALL_MARGIN, 6), 22)
    brush.text(caption, (SMALL_MARGIN, 25), 17, palette.MUTED)
    return brush.image()


class Film:
    """Keeps evenly spaced frames of an episode whose length is not known: when full, every other one is dropped.

    Frames have few colours, so each is packed to a fiftieth.
    """

    def __init__(self, most_frames: int = 160, every: int = 2) -> None:
        self.most_frames = most_frames
        self.every = every  # steps between two frames
        self._shape, self._packed = (0, 0, 0), list[bytes]()

    def __len__(self) -> int:
        return len(self._packed)

    def __getitem__(self, row: int) -> Bytes:
        """A frame (H,W,3)."""
        return np.frombuffer(zlib.decompress(self._packed[row]), np.uint8).reshape(self._shape)

    def add(self, frame: Bytes) -> None:
        """Append a frame (H,W,3); all have one size."""
        self._shape = frame.shape
        self._packed.append(zlib.compress(frame.tobytes(), 1))

    def offer(self, step: int, draw: Callable[[], Bytes]) -> None:
        """Take the picture of a step, if it is one of those that are kept; `draw` is called only then."""
        if step % self.every:
            return
        self.add(draw())
        if len(self) > self.most_frames:
            self._packed = self._packed[::2]
            self.every *= 2

    def save(self, path: Path, seconds: float = 16.0) -> None:
        """Write the film as a GIF that lasts about so long and repeats; the last frame stays a while."""
        colours = _palette(self)  # one for all: frames then differ only where something moved
        pictures = (Image.fromarray(self[row]) for row in range(len(self)))
        plain = (picture.quantize(palette=colours, dither=Image.Dither.NONE) for picture in pictures)
        each = max(20, round(1000.0 * seconds / len(self)))
        times = [each] * (len(self) - 1) + [LAST_FRAME_MS]
        next(plain).save(path, save_all=True, append_images=plain, duration=times, loop=0, optimize=True)


def _palette(frames: Film) -> Image.Image:
    """A picture with the colours of some frames spread over the film, and patches of what is small but must be seen."""
    count = min(len(frames), 5)
    some = [frames[i] for i in np.linspace(0, len(frames) - 1, count).astype(int)]
    wide = np.repeat(np.array(SMALL, np.uint8)[None], max(frames[0].shape[0] // 4, 1), axis=0)
    patches = np.repeat(wide, -(-frames[0].shape[1] // len(SMALL)), axis=1)[:, : frames[0].shape[1]]
    return Image.fromarray(np.vstack([*some, patches])).quantize(COLOURS)
