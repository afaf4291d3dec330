"""The still pictures of the story, for a reader without scripts: SVG, drawn from the same runs."""

from types import SimpleNamespace

import numpy as np

from rhec import paper
from rhec.core._casadi.build import select_inputs
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS, MEASUREMENTS, POSE
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import plant
from rhec.workbench.live import functions, window

__all__ = ["draw"]

_SIZE = (640, 300)  # of a picture [px]
_SAMPLES = 600  # two minutes


def draw(soft):
    """Draw the first picture of each step.

    Args:
        soft: Fields of Scenario that make its soil soft.

    Returns:
        {step: SVG}; the colours are properties of the page's style sheet.
    """
    calibrated = Scenario(process_noise="calibrated")
    sample = functions.build_functions(calibrated)["sample"]
    rhe = _run(calibrated, sample)
    printed = _run(Scenario(process_noise="printed"), sample)
    of_ekf = Scenario(estimator="ekf", process_noise="calibrated", **soft)
    ekf = _run(of_ekf, functions.build_functions(of_ekf)["sample"])
    tools = window.build_tools(calibrated)
    time = paper.DT_S * np.arange(_SAMPLES)
    sigma_kappa = np.sqrt(rhe.covariance[:, 5, 5])
    return dict(
        encoders=_encoders(rhe, tools),
        filter=_filter(ekf, time),
        window=_window(rhe, tools, sample=250),
        kalman=_kalman(rhe, tools, time),
        row=_svg((0, 120), (0, 0.3), [_line(time, sigma_kappa, "--run0")]),
        noise=_svg(
            (0, 120),
            (0, 1.08),
            [_line(time, printed.kappa_hat, "--run0"), _line(time, printed.kappa, "--ink")],
        ),
    )


def _run(scenario, sample):
    """A run of the closed loop: its log by column, covariances (k, n, n) and memories after it."""
    setup = closed_loop.set_up(scenario)
    noise = plant.draw_noise(scenario.seed, _SAMPLES)
    settings = select_inputs(sample, setup.settings)
    memory = setup.memory
    samples = []
    for each in noise:
        found = sample(memory=memory, noise=each, **settings)
        samples.append({name: value.full().ravel() for name, value in found.items()})
        memory = samples[-1]["memory"]
    arrays = {name: np.array([each[name] for each in samples]) for name in samples[0]}
    n = round(np.sqrt(arrays["covariance"].shape[1]))
    columns = dict(zip(COLUMNS, arrays["row"].T))
    return SimpleNamespace(
        setup=setup,
        covariance=arrays["covariance"].reshape(-1, n, n),
        memory=arrays["memory"],
        z=np.column_stack([columns[name] for name in MEASUREMENTS]),
        **columns,
    )


def _svg(across, up, marks, equal=False):
    """An SVG whose marks take the scale (x, y) -> pixels; equal: that of y for both."""
    x0, x1 = across
    y0, y1 = up
    wide, high = _SIZE
    s_y = high / (y1 - y0)
    if equal:
        half = wide / s_y / 2
        middle = (x0 + x1) / 2
        x0 = middle - half
        x1 = middle + half
    s_x = wide / (x1 - x0)

    def pixels(x, y):
        return np.column_stack([s_x * (np.asarray(x) - x0), s_y * (y1 - np.asarray(y))])

    body = "".join(mark(pixels) for mark in marks)
    for value, x, y in [(y0, -8, high), (y1, -8, 12), (x0, 12, high + 16), (x1, wide, high + 16)]:
        body += f'<text x="{x}" y="{y}" text-anchor="end">{value:.3g}</text>'
    body += f'<rect width="{wide}" height="{high}" style="fill:none;stroke:var(--line)"/>'
    box = f"-48 0 {wide + 56} {high + 20}"
    return f'<svg class="still" viewBox="{box}" aria-hidden="true">{body}</svg>'


def _line(x, y, colour, width=2, dash=""):
    def mark(pixels):
        points = " ".join(f"{u:.1f},{v:.1f}" for u, v in pixels(x, y) if np.isfinite(u + v))
        style = f"fill:none;stroke:var({colour});stroke-width:{width};stroke-dasharray:{dash}"
        return f'<polyline points="{points}" style="{style}"/>'

    return mark


def _area(x, y, colour):
    def mark(pixels):
        points = " ".join(f"{u:.1f},{v:.1f}" for u, v in pixels(x, y))
        return f'<polygon points="{points}" style="fill:var({colour});opacity:0.2"/>'

    return mark


def _dots(x, y, colour, radius, full=True):
    look = f"fill:var({colour})" if full else f"fill:none;stroke:var({colour})"

    def mark(pixels):
        return "".join(
            f'<circle cx="{u:.1f}" cy="{v:.1f}" r="{radius}" style="{look}"/>'
            for u, v in pixels(x, y)
            if np.isfinite(u + v)
        )

    return mark


def _encoders(run, tools):
    """Where the robot is, and where its encoders say it is."""
    pose = np.array([getattr(run, name)[0] for name in POSE])
    poses = [pose]
    for z_N in run.z[1:300]:
        pose = tools["reckon"](pose=pose, z_N=z_N)["pose"].full().ravel()
        poses.append(pose)
    x, y, _ = np.transpose(poses)
    path = run.setup.path.poses(np.linspace(0, run.setup.path.length_m, 400))[0]
    marks = [_line(path[:, 0], path[:, 1], "--ink", 1, "5 4")]
    marks += [_line(run.x_m[:300], run.y_m[:300], "--run0"), _line(x, y, "--run1")]
    return _svg((-9, 39), (-8, 17.5), marks, equal=True)


def _filter(run, time):
    """The EKF's yaw error within its own band."""
    error = run.theta_hat_rad - run.theta_rad
    band = 2 * np.sqrt(run.covariance[:, 2, 2])
    around = _area(np.append(time, time[::-1]), np.append(band, -band[::-1]), "--run0")
    return _svg((0, 120), (-0.25, 0.25), [around, _line(time, error, "--run1")])


def _window(run, tools, sample):
    """The window after a sample, in the frame of its middle pose."""
    memory = run.setup.unpack(run.memory[sample])["estimator"]
    s = memory["s"]
    z = memory["z"]
    x_0, y_0, theta = s[:3, s.shape[1] // 2]
    turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])

    def seen(x, y):
        return turn @ np.array([x - x_0, y - y_0])

    fits = seen(*s[:2])
    fixes = seen(*z[:2])
    L = np.linalg.cholesky(memory["P"][:2, :2])
    circle = np.linspace(0, 2 * np.pi, 41)
    ellipse = 2 * L @ np.array([np.cos(circle), np.sin(circle)])
    arrival = seen(*(np.ravel(memory["m"])[:2, None] + ellipse))
    marks = [_line(*np.transpose([a, b]), "--soft", 1) for a, b in zip(fits.T, fixes.T)]
    marks += [_dots(*fixes, "--measured", 6, full=False), _dots(*fits, "--run0", 4)]
    return _svg((-1, 1), (-0.12, 0.12), [*marks, _line(*arrival, "--plan")])


def _kalman(run, tools, time):
    """Distance between the positions of the RHE with one interval and the EKF."""
    settings = {name: run.setup.settings[name] for name in ("V", "W")}
    memories = window.first_memories(Scenario(), run.setup.guess)
    found = {name: [] for name in memories}
    for z_N in run.z:
        for name in memories:
            more = dict(P_0=run.setup.settings["P_0"]) if name == "shortest" else {}
            step = tools[name](memory=memories[name], z_N=z_N, **settings, **more)
            memories[name] = step["memory"]
            found[name].append(step["estimate"].full().ravel()[:2])
    gap = np.linalg.norm(np.subtract(*found.values()), axis=1)
    limit = _line([0, 120], [0.001, 0.001], "--ink", 1, "5 4")
    return _svg((0, 120), (0, 0.02), [_line(time, gap, "--run0"), limit])
