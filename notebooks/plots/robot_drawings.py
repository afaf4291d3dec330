"""The paper's Figures 1 to 4, which are not published with its text, drawn from its numbers.

Lengths that the paper states are to scale, in metres. Heights and positions of parts, which it does
not state, are plausible values. Sizes of texts and arrow heads are in points.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import patches
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Affine2D

from rhec import paper
from rhec.style import BLACK, BLUE, COLOURS, COLUMN_IN, GREY, SMALL_PT, VERMILLION, styled

_RUBBER = "#4d4d4d"
_METAL = "#aab2b9"
_DECK = "#dfe5ea"
_PAPER = "#f7f7f7"
_LEAF = "#9ad0ba"
_STEM = "#4f9f7f"
_GRAIN = "#c98f3c"
_SOIL = "#b9a78a"
_SENSOR = "#bfe0f5"
_COMPUTER = "#eccfe0"
_DRIVE = "#f6d79a"
_LENGTH = paper.ROBOT_LENGTH_M
_WIDTH = paper.ROBOT_WIDTH_M
_TRACK = paper.TRACK_WIDTH_M
_TREAD = _WIDTH - _TRACK
_MAST_X = 0.05  # ahead of the robot's middle [m]
_BLOCK = np.array([1.2, 0.4])  # a block of Figure 3 [in]
_LEFT = 0.80  # the two columns of Figure 3 [in]
_RIGHT = 2.60


def _canvas(xlim, ylim):
    """A column-wide figure without frame and with equal scales."""
    height_in = COLUMN_IN * np.ptp(ylim) / np.ptp(xlim)
    figure = plt.figure(figsize=(COLUMN_IN, height_in), layout="none")
    axes = figure.add_axes((0, 0, 1, 1), xlim=xlim, ylim=ylim, aspect="equal")
    axes.set_axis_off()
    return figure, axes


def _box(axes, x, y, width, height, corner=0.0, colour=_DECK, **look):
    """Draw a rectangle with centre (x, y) and rounded corners."""
    look = dict(facecolor=colour, edgecolor=BLACK, linewidth=0.6) | look
    look["boxstyle"] = f"round,pad=0,rounding_size={corner}"
    corner = x - width / 2, y - height / 2
    axes.add_patch(patches.FancyBboxPatch(corner, width, height, **look))


def _oval(axes, x, y, width, height, colour=_METAL):
    look = dict(facecolor=colour, edgecolor=BLACK, linewidth=0.6)
    axes.add_patch(patches.Ellipse((x, y), width, height, **look))


def _arrow(axes, *ends, style="-|>", **look):
    """Draw an arrow between two points or along a Path."""
    where = {"path": ends[0]} if isinstance(ends[0], Path) else {"posA": ends[0], "posB": ends[1]}
    look = dict(color=BLACK, linewidth=0.8, mutation_scale=6, shrinkA=0, shrinkB=0) | look
    axes.add_patch(patches.FancyArrowPatch(**where, arrowstyle=style, **look))


def _beside(axes, text, point, side, **look):
    """Write small text right (1, 0), left (-1, 0), above (0, 1) or below (0, -1) a point."""
    look |= {"ha": ("center", "left", "right")[side[0]], "va": ("center", "bottom", "top")[side[1]]}
    gap = (2.5 * side[0], 2 * side[1])
    look |= dict(textcoords="offset points", fontsize=SMALL_PT, linespacing=1.05)
    axes.annotate(text, point, gap, **look)


def _dimension(axes, start, end, text, side=(0, 1)):
    """Draw a dimension line with text at its middle."""
    _arrow(axes, start, end, style="<|-|>", linewidth=0.5, mutation_scale=4.5)
    _beside(axes, text, np.mean([start, end], axis=0), side)


def _leader(axes, text, at, side, part):
    """Write a text at a point, with a hairline to a dot on the part that it names."""
    halo = [withStroke(linewidth=1.4, foreground="w")]  # visible on the dark tracks
    axes.plot(*zip(at, part, strict=True), color=BLACK, linewidth=0.5, path_effects=halo)
    axes.plot(*part, "o", markersize=3, color=BLACK, markeredgecolor="w", markeredgewidth=0.5)
    _beside(axes, text, at, side)


def _sorghum(axes, x, height, stem_width):
    """Draw a plant with leaves, stem and panicle at x."""
    shares = (0.42, 0.50, 0.66, 0.74, 0.90, 0.97)
    reaches = (0.17, -0.17, 0.19, -0.19, 0.15, -0.13)
    drops = (0.08, 0.06, 0.03, 0.02, -0.02, -0.03)
    for share, reach, drop in zip(shares, reaches, drops):
        start = np.array([x, share * height])
        tip = np.array([x + reach, share * height - drop])
        bend = (start + tip) / 2 + (0, 0.13)
        outline = [start, bend + (0, 0.03), tip, bend - (0, 0.03), start]
        leaf = Path(outline, [Path.MOVETO] + [Path.CURVE3] * 4)
        axes.add_patch(patches.PathPatch(leaf, facecolor=_LEAF, edgecolor=_STEM, linewidth=0.3))
    corner = (x - stem_width / 2, 0)
    size = (stem_width, height)
    axes.add_patch(patches.Rectangle(corner, *size, color=_STEM, linewidth=0))
    grain = np.arange(90)
    radius = np.sqrt(grain / grain.size)
    turn = 2.4 * grain  # near the golden angle, which spreads grains evenly
    across = x + 0.026 * radius * np.cos(turn)
    up = height + 0.06 + 0.085 * radius * np.sin(turn)
    axes.scatter(across, up, 5, _GRAIN, edgecolors="w", linewidths=0.15)


def _rear_view(axes):
    """Draw the robot from behind on y = 0: tracks, body, deck, mast, sensors, antenna."""
    for x in (-_TRACK / 2, _TRACK / 2):
        _box(axes, x, 0.12, _TREAD, 0.24, 0.02, _RUBBER)
        lugs = np.arange(0.03, 0.23, 0.03)
        half = 0.35 * _TREAD
        axes.hlines(lugs, x - half, x + half, color=_METAL, linewidth=0.5, zorder=1)
    _box(axes, 0, 0.14, _TRACK - _TREAD, 0.12, 0, _METAL)
    _box(axes, 0, 0.255, 0.84 * _WIDTH, 0.11, 0.015)
    _box(axes, 0, 0.475, 0.028, 0.33, 0, _METAL)
    _box(axes, 0, 0.495, 0.12, 0.05, 0.01, _SENSOR)
    _oval(axes, 0, 0.66, 0.15, 0.06, _SENSOR)


def _beside_a_row(axes, row):
    """Draw the space that a row takes from the robot, enlarged in a strip below."""
    stem = row - paper.STEM_WIDTH_M / 2
    effective = stem - paper.GNSS_ACCURACY_M / 2
    left = effective - 0.02
    right = row + paper.STEM_WIDTH_M / 2
    beam = [(left, -0.25), (right, -0.25), (0.58, -0.36), (-0.58, -0.36)]
    axes.add_patch(patches.Polygon(beam, color="0.94", linewidth=0))
    place = (-0.58, -0.49, 1.16, 0.13)
    limits = dict(xlim=(left, right), ylim=(0, 1))
    strip = axes.inset_axes(place, transform=axes.transData, **limits)
    strip.set_axis_off()
    for start, end, colour, text in [
        (left, effective, COLOURS["tolerance"], "free"),
        (effective, stem, COLOURS["measured"], "half the\nGNSS accuracy"),
        (stem, row, _STEM, "half\na stem"),
        (row, right, _STEM, ""),
    ]:
        strip.axvspan(start, end, color=colour, alpha=0.6, linewidth=0)
        _beside(strip, text, ((start + end) / 2, 0), (0, -1))
    strip.axvline(row, color=BLACK, linewidth=0.6, linestyle="-.")
    _beside(strip, "row’s\ncentre line", (row, 0), (1, -1))
    _dimension(strip, (effective, 0.4), (stem, 0.4), f"{stem - effective:.3f} m")
    _dimension(strip, (stem, 0.4), (row, 0.4), f"{row - stem:.3f} m")


@styled
def robot_in_row():
    """Draw Figure 1: the robot between two rows, with the tolerance of 0.12 m on either side.

    The tolerance leaves out half a stem and half the GNSS accuracy. Widths are to scale.
    """
    row = paper.ROW_SPACING_M / 2
    edge = _WIDTH / 2
    effective = paper.ROW_SPACING_M - paper.STEM_WIDTH_M - paper.GNSS_ACCURACY_M
    tolerance = (effective - _WIDTH) / 2
    figure, axes = _canvas((-0.62, 0.62), (-0.69, 0.74))

    axes.add_patch(patches.Rectangle((-0.62, -0.02), 1.24, 0.02, color=_SOIL, linewidth=0))
    free = dict(color=COLOURS["tolerance"], alpha=0.6, linewidth=0)
    for side in (-1, 1):
        axes.fill_between([side * edge, side * effective / 2], 0.31, **free)
        _sorghum(axes, side * row, 0.55, paper.STEM_WIDTH_M)
        _dimension(axes, (side * edge, -0.08), (side * effective / 2, -0.08), f"{tolerance:.2f} m")
    _rear_view(axes)

    for y, half, text in [
        (-0.08, edge, f"robot {_WIDTH:.2f} m"),
        (-0.16, effective / 2, f"effective row spacing {effective:.2f} m"),
        (-0.24, row, f"row spacing {paper.ROW_SPACING_M:.2f} m, centre to centre"),
    ]:
        axes.vlines([-half, half], y - 0.01, -0.02, color=GREY, linewidth=0.4)
        _dimension(axes, (-half, y), (half, y), text)
    _beside_a_row(axes, row)
    terms = (paper.ROW_SPACING_M, paper.STEM_WIDTH_M, paper.GNSS_ACCURACY_M, _WIDTH)
    taken = "-".join(f"{term:.2f}" for term in terms)
    formula = rf"$({taken})\,/\,2={tolerance:.2f}$ m on either side"
    axes.text(0, -0.64, formula, ha="center", va="center")
    return figure


def _side_view(axes):
    """Draw the robot from the right on y = 0: deck, track, mast, sensors, antenna."""
    _box(axes, 0, 0.235, _LENGTH - 0.12, 0.15, 0.02)
    _box(axes, 0, 0.12, _LENGTH, 0.24, 0.12, _RUBBER)
    lugs = dict(edgecolor=_METAL, linewidth=1, linestyle=(0, (0.6, 1.6)))
    _box(axes, 0, 0.12, _LENGTH - 0.024, 0.216, 0.108, "none", **lugs)
    _box(axes, 0, 0.12, _LENGTH - 0.06, 0.18, 0.09)
    for x in (0.12 - _LENGTH / 2, _LENGTH / 2 - 0.12):
        _oval(axes, x, 0.12, 0.156, 0.156)
        _oval(axes, x, 0.12, 0.04, 0.04, _DECK)
    for x in np.linspace(-0.24, 0.24, 4):
        _oval(axes, x, 0.072, 0.076, 0.076)
    _box(axes, _MAST_X, 0.49, 0.028, 0.36, 0, _METAL)
    _box(axes, _MAST_X + 0.049, 0.48, 0.07, 0.06, 0.01, _SENSOR)
    _oval(axes, _MAST_X, 0.69, 0.15, 0.06, _SENSOR)


def _top_view(axes, y):
    """Draw the robot from above without its deck, centred at (0, y) and heading right."""
    _box(axes, 0, y, _LENGTH - 0.12, _TRACK - _TREAD, 0.02)
    for side in (-1, 1):
        track = y + side * _TRACK / 2
        _box(axes, 0, track, _LENGTH, _TREAD, 0.02, _RUBBER)
        lugs = np.arange(0.03, _LENGTH - 0.02, 0.04) - _LENGTH / 2
        axes.vlines(lugs, track - 0.35 * _TREAD, track + 0.35 * _TREAD, color=_METAL, linewidth=0.5)
        _box(axes, -0.37, y + side * 0.105, 0.08, 0.11, 0.01, _DRIVE)  # motor, its encoder, battery
        _box(axes, -0.37, y + side * 0.038, 0.06, 0.024, 0, _SENSOR)
        _box(axes, 0.28, y + side * 0.07, 0.26, 0.11, 0.01, _METAL)
    _box(axes, -0.225, y + 0.07, 0.09, 0.08, 0, _DRIVE)  # motor driver, motion controller, computer
    _box(axes, -0.23, y - 0.07, 0.06, 0.06, 0, _DRIVE)
    _box(axes, -0.08, y - 0.06, 0.10, 0.065, 0, _COMPUTER)
    _oval(axes, _MAST_X, y, 0.05, 0.05)


@styled
def robot_parts():
    """Draw Figure 2: the robot and its parts, from the side and from above."""
    figure, axes = _canvas((-0.72, 0.72), (-0.99, 0.76))
    axes.axhline(0, color=_SOIL, linewidth=1.5, zorder=0)
    _side_view(axes)
    y = -0.55
    half = _WIDTH / 2
    _top_view(axes, y)

    right = (1, 0)
    left = (-1, 0)
    up = (0, 1)
    down = (0, -1)
    above = y + half + 0.05
    below = y - half - 0.05
    antenna = f"RTK GNSS antenna,\n{paper.GNSS_ACCURACY_M:.2f} m at {paper.GNSS_RATE_HZ:.0f} Hz"
    encoders = f"encoders,\n{paper.ENCODER_ACCURACY_MPS:.3f} m/s"
    kangaroo = f"Kangaroo x2, two\nPID loops, {paper.SPEED_LOOP_RATE_HZ:.0f} Hz"
    computer = "on-board computer,\nRaspberry Pi 3"
    batteries = "LiPo batteries,\n12 V, 40 Ah each"
    for text, at, side, part in [
        (antenna, (0.23, 0.69), right, (0.09, 0.69)),
        ("plant imaging\nsensors", (0.23, 0.48), right, (0.11, 0.48)),
        ("mast, set to the\ncanopy’s height", (-0.15, 0.56), left, (_MAST_X, 0.56)),
        ("deck", (-0.46, 0.39), up, (-0.36, 0.28)),
        ("DC motors,\n200 W each", (-0.49, above), up, (-0.37, y + 0.12)),
        ("Sabertooth\nmotor driver", (-0.15, above), up, (-0.225, y + 0.08)),
        (batteries, (0.34, above), up, (0.28, y + 0.09)),
        (encoders, (-0.53, below), down, (-0.37, y - 0.037)),
        (kangaroo, (-0.20, below), down, (-0.23, y - 0.07)),
        (computer, (0.17, below), down, (-0.08, y - 0.06)),
        ("tracks", (0.50, below), down, (0.45, y - _TRACK / 2)),
    ]:
        _leader(axes, text, at, side, part)

    _beside(axes, f"mass {paper.ROBOT_MASS_KG:.0f} kg", (-0.70, 0.69), right)
    _arrow(axes, (0.55, 0.12), (0.69, 0.12))
    _beside(axes, "forward", (0.62, 0.13), up)
    _dimension(axes, (-_LENGTH / 2, -0.05), (_LENGTH / 2, -0.05), f"{_LENGTH:.2f} m", down)
    _dimension(axes, (-0.56, y - half), (-0.56, y + half), f"{_WIDTH:.2f} m", left)
    tracks = [(0.56, y + side * _TRACK / 2) for side in (-1, 1)]
    _dimension(axes, *tracks, f"$b$, ours:\n{_TRACK:.2f} m", right)
    return figure


def _link(axes, start, end, text):
    """Draw a signal between two blocks, from their centres."""
    start = np.array(start)
    end = np.array(end)
    half = np.sign(end - start) * _BLOCK / 2
    _arrow(axes, start + half, end - half, mutation_scale=7)
    _beside(axes, text, (start + end) / 2, (1, 0) if start[0] == end[0] else (0, 1))


_BLOCKS = [  # title, detail, place [in], colour
    ("RTK GNSS", f"receiver, {paper.GNSS_RATE_HZ:.0f} Hz", _LEFT, 3.55, _SENSOR),
    ("Reference", "trajectory", _RIGHT, 3.55, _PAPER),
    ("RHE", "estimator", _LEFT, 2.65, _COMPUTER),
    ("RHC", "controller", _RIGHT, 2.65, _COMPUTER),
    ("Encoders", "one on each motor", _LEFT, 1.60, _SENSOR),
    ("Kangaroo x2", f"two PID loops, {paper.SPEED_LOOP_RATE_HZ:.0f} Hz", _RIGHT, 1.60, _DRIVE),
    ("DC motors", "left and right, 200 W", _LEFT, 0.92, _DRIVE),
    ("Sabertooth", "dual 12 A driver", _RIGHT, 0.92, _DRIVE),
    ("Tracks", "left and right", _LEFT, 0.24, _METAL),
]
_SIGNALS = [  # from, to, what is sent
    ("RTK GNSS", "RHE", "$x,\\ y$\nover Bluetooth"),
    ("Encoders", "RHE", r"$\nu,\ \omega$"),
    ("RHE", "RHC", r"$\hat\xi,\ \hat p$"),
    ("Reference", "RHC", r"$\xi_r$"),
    ("RHC", "Kangaroo x2", "$\\omega_\\mathrm{cmd}$\nand speed"),
    ("Encoders", "Kangaroo x2", r"$\nu_l,\ \nu_r$"),
    ("Kangaroo x2", "Sabertooth", "commands"),
    ("Sabertooth", "DC motors", "voltages"),
    ("DC motors", "Encoders", "shafts"),
    ("DC motors", "Tracks", "torques"),
]


@styled
def hardware_blocks():
    """Draw Figure 3: the hardware, from sensors through RHE and RHC to the tracks."""
    figure, axes = _canvas((0, COLUMN_IN), (0, 3.8))
    _box(axes, 1.7, 2.60, 3.28, 0.68, 0.06, "0.96", edgecolor=GREY, linestyle="--")
    computer = f"on-board computer: Raspberry Pi 3, {paper.GNSS_RATE_HZ:.0f} Hz"
    _beside(axes, computer, (1.7, 2.35), (0, 0))
    for title, detail, x, y, colour in _BLOCKS:
        _box(axes, x, y, *_BLOCK, 0.05, colour)
        axes.text(x, y + 0.075, title, ha="center", va="center", weight="bold")
        _beside(axes, detail, (x, y - 0.085), (0, 0))
    places = {title: (x, y) for title, _, x, y, _ in _BLOCKS}
    for start, end, text in _SIGNALS:
        _link(axes, places[start], places[end], text)
    for y, colour, text in [
        (0.45, _SENSOR, "measures"),
        (0.28, _COMPUTER, "computes"),
        (0.11, _DRIVE, "drives"),
    ]:
        _box(axes, _RIGHT - 0.2, y, 0.16, 0.09, 0.02, colour)
        _beside(axes, text, (_RIGHT - 0.1, y), (1, 0))
    return figure


# Figure 4: pose, traction, and speeds as lengths of arrows [m].
_X = 0.86
_Y = 0.80
_THETA = np.radians(35)
_MU = 0.75
_KAPPA = 0.65
_NU = 0.92
_NU_LEFT = 0.78
_NU_RIGHT = 1.06
_WITHOUT_SLIP = {"color": GREY, "linestyle": (0, (3, 2))}
_THIN = {"color": GREY, "linewidth": 0.5, "linestyle": ":"}


def _in_robot_frame(along, across):
    """Coordinates in the plane of a point in the robot's frame."""
    cos = np.cos(_THETA)
    sin = np.sin(_THETA)
    return _X + along * cos - across * sin, _Y + along * sin + across * cos


def _on_circle(radius, angle):
    """Points at angles [rad] on a circle around the robot."""
    return np.transpose([_X + radius * np.cos(angle), _Y + radius * np.sin(angle)])


def _write(axes, text, at, **look):
    axes.text(*at, text, **{"ha": "center", "va": "center"} | look)


def _draw_axes(axes):
    """Draw the axes of the plane and the coordinates of the robot."""
    for tip, foot, name, below in [
        ((1.80, 0), (_X, 0), "$x$", (_X, -0.10)),
        ((0, 1.72), (0, _Y), "$y$", (-0.10, _Y)),
    ]:
        _arrow(axes, (0, 0), tip)
        axes.plot(*zip((_X, _Y), foot, strict=True), **_THIN)
        _write(axes, name, below)


def _draw_tracks(axes):
    """Draw body, tracks, track speeds, and the distance b of the tracks."""
    track = _TRACK / 2
    rear = -_LENGTH / 2
    robot = Affine2D().rotate(_THETA).translate(_X, _Y) + axes.transData
    _box(axes, 0, 0, 0.84, _TRACK, transform=robot)
    for across, speed, name in [(track, _NU_LEFT, r"$\nu_l$"), (-track, _NU_RIGHT, r"$\nu_r$")]:
        _box(axes, 0, across, _LENGTH, _TREAD, 0.02, _METAL, transform=robot)
        ends = (_in_robot_frame(0, across), _in_robot_frame(speed, across))
        _arrow(axes, *ends, **_WITHOUT_SLIP)
        _write(axes, name, _in_robot_frame(speed + 0.08, across))
    ends = (_in_robot_frame(rear - 0.08, track), _in_robot_frame(rear - 0.08, -track))
    _dimension(axes, *ends, "")
    _write(axes, "$b$", _in_robot_frame(rear - 0.16, 0))


def _draw_velocities(axes):
    """Draw yaw, speed and yaw rate without slip (dashed) and with slip."""
    axes.plot([_X, _X + 0.5], [_Y, _Y], **_THIN)
    axes.add_patch(patches.Arc((_X, _Y), 0.56, 0.56, theta2=np.degrees(_THETA), linewidth=0.6))
    _write(axes, r"$\theta$", _in_robot_frame(0.33, -0.10))
    _arrow(axes, (_X, _Y), _in_robot_frame(_NU, 0), **_WITHOUT_SLIP)
    _arrow(axes, (_X, _Y), _in_robot_frame(_MU * _NU, 0), color=BLUE, linewidth=1.4)
    _write(axes, r"$\nu$", _in_robot_frame(_NU + 0.07, 0))
    _write(axes, r"$\mu\nu$", _in_robot_frame(_MU * _NU + 0.06, 0.09), color=BLUE)
    turn = np.radians(85) * np.linspace(1, 2, 30)
    slipped = np.radians(85) * np.linspace(1, 1 + _KAPPA, 30)
    _arrow(axes, Path(_on_circle(0.50, turn)), **_WITHOUT_SLIP)
    _arrow(axes, Path(_on_circle(0.42, slipped)), color=VERMILLION, linewidth=1.4)
    _write(axes, r"$\omega$", _on_circle(0.58, turn[20]))
    _write(axes, r"$\kappa\omega$", _on_circle(0.40, turn[24]), color=VERMILLION)
    axes.plot(_X, _Y, "o", markersize=3, color=BLACK)


@styled
def schematic():
    """Draw Figure 4: the pose and eq. (2), without slip and with μ = 0.75 and κ = 0.65."""
    figure, axes = _canvas((-0.20, 2.98), (-0.20, 1.78))
    _draw_axes(axes)
    _draw_tracks(axes)
    _draw_velocities(axes)
    for height, equation in [
        (1.60, r"$\dot{x}=\mu\nu\,\cos\theta$"),
        (1.40, r"$\dot{y}=\mu\nu\,\sin\theta$"),
        (1.20, r"$\dot{\theta}=\kappa\omega$"),
        (0.85, r"$\nu=(\nu_l+\nu_r)/2$"),
        (0.65, r"$\omega=(\nu_r-\nu_l)/b$"),
    ]:
        _write(axes, equation, (2.14, height), ha="left", fontsize=9)
    _write(axes, "(2)", (2.94, 1.40), ha="right")
    for height, note, colour in [
        (0.34, "dashed: no slip", GREY),
        (0.18, r"longitudinal slip $1-\mu$", BLUE),
        (0.02, r"turning lost: $1-\kappa$", VERMILLION),
    ]:
        _write(axes, note, (2.14, height), ha="left", fontsize=SMALL_PT, color=colour)
    return figure
