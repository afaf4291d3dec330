"""The log that the project ships: the simulated robot driven open loop, recorded as a real robot's logger would.

Forward, backward, standing still and turning on the spot, at changing speeds, on a slip field, in two pieces. Ten rows a second, with a
new position in every other one; between them the last position is repeated and pos_ok is 0. `python -m rhec.example_log` makes the file again.
"""

from pathlib import Path

import numpy as np
import pandas as pd

from rhec import paper, robot
from rhec.closed_loop import draw_noise
from rhec.function import unpack
from rhec.terrain import Terrain, flat, lookup

FILE = Path(__file__).parents[1] / "data" / "example_log.csv"
DT_S = 0.1
SEED = 2018
GNSS_SIGMA_M = 0.02
BOX = (-25.0, 35.0, -30.0, 30.0)   # of the slip field [m]

# Commands (duration [s], speed [m/s], yaw rate [rad/s]), and the pose where each piece begins
PIECES = [
    ((0.0, 0.0, 0.4), [(4, 0, 0), (12, 0.5, 0), (8, 0.5, 0.3), (8, 0.8, -0.25), (3, 0, 0), (10, -0.5, 0), (8, -0.4, 0.35), (3, 0, 0), (5, 0, 0.7),
                       (10, 0.6, 0), (12, 0.35, -0.4), (8, 1.0, 0.1), (6, -0.7, -0.3), (4, 0, -0.7), (14, 0.5, 0.15), (5, 0, 0)]),
    ((-3.0, 4.0, -2.0), [(10, 0.4, 0.2), (10, 0.7, -0.3), (6, -0.6, 0), (5, -0.3, 0.5), (4, 0, 0), (20, 0.5, 0), (10, 0.9, 0.2), (10, 0.3, -0.5),
                         (8, -0.5, 0.2), (20, 0.6, 0.25), (4, 0, 0)]),
]


def record(pose, commands, terrain, seed):
    """One piece: what the logger wrote, and the truth. Noise is that of `seed`."""
    drive, slip = robot.drive(DT_S), lookup(terrain.mu.shape)
    body = dict(track_width_m=paper.TRACK_WIDTH_M, encoder_sigma_mps=0.0, bump_sigma_radps=0.02)
    memory = {name: robot.start(pose, 0.0)[name] for name in ("pose", "tracks", "integral")}
    samples = [command for duration, *command in commands for _ in range(round(duration / DT_S))]
    rows = []
    for (speed_mps, omega_radps), noise in zip(samples, draw_noise(seed, len(samples))):
        noise = {name: np.array(value) for name, value in unpack(noise, robot.NOISE).items()}
        traction = np.array(slip(memory["pose"][:2], terrain.origin_m, terrain.cell_m, flat(terrain))).ravel()
        tracks = memory["tracks"].ravel()
        nu, omega = robot.body_speeds(tracks, paper.TRACK_WIDTH_M)
        left, right = tracks + paper.ENCODER_SIGMA_MPS * noise["encoder"][:, 0]
        rows.append([*memory["pose"].ravel(), traction[0] * nu, traction[1] * omega, left, right, *GNSS_SIGMA_M * noise["white"].ravel()])
        result = drive(**memory, speed_mps=speed_mps, omega_radps=omega_radps, traction=traction, bump=noise["bump"], encoder=noise["encoder"], **body)
        memory = {name: np.array(result[name]).ravel() for name in memory}
    x, y, theta, v, yaw_rate, left, right, error_x, error_y = np.transpose(rows)
    new = np.arange(len(rows)) % round(paper.DT_S / DT_S) == 0
    latest = np.maximum.accumulate(np.where(new, np.arange(len(rows)), 0))
    nu, omega = robot.body_speeds((left, right), paper.TRACK_WIDTH_M)
    return pd.DataFrame(dict(
        t_s=DT_S * np.arange(len(rows)), x_m=(x + error_x)[latest], y_m=(y + error_y)[latest], pos_ok=new.astype(int), speed_mps=nu, yaw_rate_radps=omega,
        v_left_mps=left, v_right_mps=right, yaw_true_rad=theta, x_true_m=x, y_true_m=y, v_true_mps=v, yaw_rate_true_radps=yaw_rate))


def example_log():
    """The whole log, as its file has it."""
    terrain = Terrain.random(SEED, BOX, (0.9, 0.8), (0.04, 0.08), 4.0)
    pieces, begin = [], 0.0
    for number, (pose, commands) in enumerate(PIECES):
        piece = record(pose, commands, terrain, SEED + number)
        pieces.append(piece.assign(t_s=piece["t_s"] + begin, segment=number))
        begin = pieces[-1]["t_s"].iloc[-1] + 30.0   # the logger was off meanwhile
    log = pd.concat(pieces, ignore_index=True)
    return log[["segment", *log.columns.drop("segment")]].round(4)


if __name__ == "__main__":
    example_log().to_csv(FILE, index=False)
