"""Make data/example_log.csv: the simulated robot, driven open loop and recorded like a real one.

`python data/make_example_log.py` writes the file. The robot drives forward and backward, stands
still and turns on the spot, at changing speeds, on a slip field, in two pieces. The log has ten
rows a second. Every other row has a new position; the others repeat it, and their pos_ok is 0.
"""

from pathlib import Path

import casadi as ca
import numpy as np
import pandas as pd

from rhec import paper
from rhec.core import runner
from rhec.core._casadi.build import packed_size, select_inputs, unpack, with_packed_memory
from rhec.core._casadi.packing import pack_array
from rhec.simulation.columns import RECORDED_TRUTH, TRACKS
from rhec.tracked_robot import plant as robot
from rhec.tracked_robot.terrain import Terrain, flat, lookup

__all__ = ["FILE", "example_log"]

FILE = Path(__file__).with_name("example_log.csv")
_DT_S = 0.1
_SEED = 2018
_GNSS_SIGMA_M = 0.02
_BUMP_SIGMA_RADPS = 0.02
_BOX = (-25.0, 35.0, -30.0, 30.0)  # of the slip field [m]

# Each piece: the pose where it begins, then its commands (duration [s], speed [m/s],
# yaw rate [rad/s]).
_PIECES = [
    (
        (0.0, 0.0, 0.4),
        [
            (4, 0, 0),
            (12, 0.5, 0),
            (8, 0.5, 0.3),
            (8, 0.8, -0.25),
            (3, 0, 0),
            (10, -0.5, 0),
            (8, -0.4, 0.35),
            (3, 0, 0),
            (5, 0, 0.7),
            (10, 0.6, 0),
            (12, 0.35, -0.4),
            (8, 1.0, 0.1),
            (6, -0.7, -0.3),
            (4, 0, -0.7),
            (14, 0.5, 0.15),
            (5, 0, 0),
        ],
    ),
    (
        (-3.0, 4.0, -2.0),
        [
            (10, 0.4, 0.2),
            (10, 0.7, -0.3),
            (6, -0.6, 0),
            (5, -0.3, 0.5),
            (4, 0, 0),
            (20, 0.5, 0),
            (10, 0.9, 0.2),
            (10, 0.3, -0.5),
            (8, -0.5, 0.2),
            (20, 0.6, 0.25),
            (4, 0, 0),
        ],
    ),
]
_MEMORY = {name: robot.MEMORY[name] for name in ("pose", "tracks", "integral")}
_COLUMNS = ["x_m", "y_m", *TRACKS, *RECORDED_TRUTH.values()]


def _build_sample(terrain):
    """Function (memory, command and noise) -> (memory, row), one row of _COLUMNS.

    The encoder measurements are those of this instant, not means.
    """
    drive = robot.drive(_DT_S)
    slip = lookup(terrain.mu.shape)
    body = dict(
        track_width_m=paper.TRACK_WIDTH_M, encoder_sigma_mps=0.0, bump_sigma_radps=_BUMP_SIGMA_RADPS
    )

    @with_packed_memory("sample", _MEMORY, inputs=(2 + packed_size(robot.NOISE), 1))
    def sample(pose, tracks, integral, inputs):
        command = inputs[:2]
        noise = unpack(inputs[2:], robot.NOISE)
        traction = slip(pose[:2], terrain.origin_m, terrain.cell_m, flat(terrain))
        row = ca.vertcat(
            pose[:2] + _GNSS_SIGMA_M * noise["white"],
            tracks + paper.ENCODER_SIGMA_MPS * noise["encoder"][:, 0],
            pose,
            traction * ca.vertcat(*robot.body_speeds(tracks, paper.TRACK_WIDTH_M)),
        )
        driven = drive(
            pose=pose,
            tracks=tracks,
            integral=integral,
            speed_mps=command[0],
            omega_radps=command[1],
            traction=traction,
            **select_inputs(drive, noise),
            **body,
        )
        return {name: driven[name] for name in _MEMORY} | dict(row=row)

    return sample


def _record(pose, commands, terrain, seed):
    """One piece of the log: the robot starts at this pose and follows the commands."""
    rows = []
    for duration_s, speed_mps, yaw_rate_radps in commands:
        rows += [(speed_mps, yaw_rate_radps)] * round(duration_s / _DT_S)
    stream = np.hstack([np.array(rows), robot.draw_noise(seed, len(rows))])
    first = robot.init(pose, 0.0)
    memory = pack_array({name: first[name] for name in _MEMORY})
    rows = runner.run_one(runner.build(_build_sample(terrain)), memory, stream, {})
    log = pd.DataFrame(rows, columns=_COLUMNS)
    log.insert(0, "t_s", _DT_S * np.arange(len(log)))
    # A receiver's logger repeats the last position until a new one comes.
    is_new = log.index % round(paper.DT_S / _DT_S) == 0
    log.loc[~is_new, ["x_m", "y_m"]] = np.nan
    nu, omega = robot.body_speeds((log["v_left_mps"], log["v_right_mps"]), paper.TRACK_WIDTH_M)
    return log.ffill().assign(pos_ok=is_new.astype(int), speed_mps=nu, yaw_rate_radps=omega)


def example_log():
    """The whole log, as in its file; the logger is off for half a minute between the pieces."""
    terrain = Terrain.random(_SEED, _BOX, (0.9, 0.8), (0.04, 0.08), 4.0)
    pieces = []
    begin = 0.0
    for segment, (pose, commands) in enumerate(_PIECES):
        piece = _record(pose, commands, terrain, _SEED + segment)
        pieces.append(piece.assign(segment=segment, t_s=piece["t_s"] + begin))
        begin = pieces[-1]["t_s"].iloc[-1] + 30.0
    order = ["segment", "t_s", "x_m", "y_m", "pos_ok", "speed_mps", "yaw_rate_radps", *_COLUMNS[2:]]
    return pd.concat(pieces, ignore_index=True)[order].round(4)


if __name__ == "__main__":
    example_log().to_csv(FILE, index=False)
