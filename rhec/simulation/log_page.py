"""What each column of a log and each metric holds: its unit and meaning, written once.

Units are SI. Yaw is counter-clockwise from the x axis and unwrapped. NaN stands for an unknown
value. No run imports this module. docs/log_columns.md is made from it:

    python -m rhec.simulation.log_page > docs/log_columns.md
"""

from itertools import groupby
from typing import NamedTuple


class Column(NamedTuple):
    """What one column of a log holds.

    Attributes:
        unit: Its unit; "-" for a ratio, "" for a flag or a number without a scale.
        text: What it means.
        tables: Which tables have it: "run", "recording", "replay".
    """

    unit: str
    text: str
    tables: tuple[str, ...]


_RUN = ("run",)
_RECORDING = ("recording",)
_REPLAY = ("replay",)
_BOTH = ("run", "replay")
_FROM_LOG = ("recording", "replay")
_EVERY = ("run", "recording", "replay")

# Names that share unit and meaning, unit, meaning, tables. This order is that of the page.
_TABLE = (
    ("t_s", "s", "time of the measurement; in a run since its beginning", _EVERY),
    # The truth, which no estimator sees
    ("x_m y_m", "m", "true position; in a recording the measured one of the antenna", _EVERY),
    ("theta_rad", "rad", "true yaw", _BOTH),
    ("nu_mps", "m/s", "true speed of the tracks", _RUN),
    ("omega_radps", "rad/s", "true yaw rate of the tracks", _RUN),
    ("mu", "-", "true traction: over ground the robot moves at μν", _BOTH),
    ("kappa", "-", "true traction: over ground the robot turns at κω", _BOTH),
    (
        "yaw_drift_radpm",
        "rad/m",
        "true yaw per metre over ground by unlike slip of the tracks: δ in θ' = κω + μνδ",
        _RUN,
    ),
    # The measurements z
    ("x_meas_m y_meas_m", "m", "GNSS position; NaN where there is none", _BOTH),
    ("nu_meas_mps", "m/s", "encoders: mean speed since the last sample", _BOTH),
    ("omega_meas_radps", "rad/s", "encoders: mean yaw rate since the last sample", _BOTH),
    ("gyro_meas_radps", "rad/s", "with a gyro: its mean since the last sample", _BOTH),
    ("heading_meas_rad", "rad", "with a heading: its measurement, within ±π", _BOTH),
    # The estimate
    ("x_hat_m y_hat_m", "m", "estimated position", _BOTH),
    ("theta_hat_rad", "rad", "estimated yaw", _BOTH),
    ("nu_hat_mps", "m/s", "estimated speed of the tracks", _BOTH),
    ("mu_hat kappa_hat", "-", "estimated traction", _BOTH),
    # The controller and the path
    ("omega_cmd_radps", "rad/s", "commanded yaw rate", _RUN),
    ("s_m", "m", "arc length of the point of the path closest to the estimate", _RUN),
    ("curvature_radpm", "rad/m", "curvature of the path at that point", _RUN),
    ("on_straight", "", "whether the path is straight at its point closest to the robot", _RUN),
    ("error_m", "m", "distance from the GNSS position to the path, as in the paper (R11)", _RUN),
    ("error_true_m", "m", "distance from the true position to the path", _RUN),
    # The solvers
    ("kkt_rhe", "", "KKT tolerance of the RHE (R12); NaN for other estimators", _BOTH),
    ("kkt_rhc", "", "KKT tolerance of the RHC (R12); 0 for a controller without one", _RUN),
    ("deviance", "", "-2 log likelihood of the measurement, up to a constant", _BOTH),
    ("ok", "", "whether the QPs were solved (1), and the RHE rejected no position", _BOTH),
    (
        "position_accepted encoders_accepted",
        "",
        "False where missing or rejected; encoders are not judged, but an odd yaw rate is left out "
        "beside a position that contradicts it",
        _BOTH,
    ),
    ("restarted", "", "whether the RHE restarted", _BOTH),
    # A recording, besides t_s, x_m and y_m
    ("speed_mps", "m/s", "speed by the encoders, not corrected for slip", _RECORDING),
    ("yaw_rate_radps", "rad/s", "yaw rate by the encoders, not corrected for slip", _RECORDING),
    ("v_left_mps v_right_mps", "m/s", "instead of these two: speed of each track", _RECORDING),
    ("gyro_radps", "rad/s", "optional: yaw rate by a gyro, counter-clockwise", _RECORDING),
    ("heading_rad", "rad", "optional: direction from the x axis, counter-clockwise", _RECORDING),
    ("segment", "", "optional: the drive has a break where this changes", _FROM_LOG),
    ("pos_ok", "", "optional: 0 or False where the position is to be ignored", _RECORDING),
    ("encoders_ok", "", "optional: 0 or False where the encoders are to be ignored", _RECORDING),
    ("x_true_m y_true_m", "m", "optional: true position; no estimator sees it", _RECORDING),
    ("yaw_true_rad", "rad", "optional: true yaw", _RECORDING),
    ("v_true_mps", "m/s", "optional: true speed over ground", _FROM_LOG),
    ("yaw_rate_true_radps", "rad/s", "optional: true yaw rate", _FROM_LOG),
    # A replay, besides the names of a run
    ("arm_forward_hat_m", "m", "estimated place of the antenna, ahead of the centre", _REPLAY),
    ("arm_left_hat_m", "m", "estimated place of the antenna, left of the centre", _REPLAY),
    ("sigma_x_m sigma_y_m", "m", "standard deviation of the estimated position", _REPLAY),
    ("sigma_theta_rad", "rad", "standard deviation of the estimated yaw", _REPLAY),
    ("sigma_nu_mps", "m/s", "standard deviation of the estimated speed", _REPLAY),
    ("sigma_mu sigma_kappa", "-", "standard deviation of the estimated traction", _REPLAY),
    ("sigma_arm_forward_m sigma_arm_left_m", "m", "standard deviation of that place", _REPLAY),
    ("heading_meas_rad_age_s", "s", "its age when the estimator used it", _REPLAY),
    ("gyro_accepted", "", "with a gyro: False where missing, stuck or contrary", _REPLAY),
    ("gyro_bias_hat_radps", "rad/s", "estimated bias of the gyro", _REPLAY),
    ("gyro_scale_hat", "-", "estimated scale of the gyro", _REPLAY),
    ("sigma_gyro_bias_radps", "rad/s", "standard deviation of that bias", _REPLAY),
    ("sigma_gyro_scale", "-", "standard deviation of that scale", _REPLAY),
    (
        "x_meas_m_age_s y_meas_m_age_s",
        "s",
        "age of the position when the estimator used it",
        _REPLAY,
    ),
    ("innovation_x_m innovation_y_m", "m", "measured position less the predicted one", _REPLAY),
    ("sigma_by_course_rad", "rad", "what sigma_theta_rad has by the course", _REPLAY),
)
COLUMNS_BY_NAME = {
    name: Column(unit, text, tables)
    for names, unit, text, tables in _TABLE
    for name in names.split()
}

# Unit and definition of each metric, in the order of `metrics`. "Settled" samples are those from
# the end of the 5 s that make the robot settled; of a run that never settles, all samples.
METRICS = {
    "settling_time_s": ("s", "when the true error begins to stay below 0.12 m for 5 s; or NaN"),
    "mean_error_m": ("m", "mean of `error_m` where there is a position, as in the paper (R11)"),
    "mean_error_true_m": ("m", "mean of `error_true_m`"),
    "max_error_true_m": ("m", "largest `error_true_m`"),
    # The reference is the corner of a robot that stands in the middle of its row, not turned.
    "max_corner_error_true_m": ("m", "on straights: how much nearer to the crop a corner is"),
    "mean_speed_mps": ("m/s", "mean of the tracks' speed, as an absolute value"),
    "violations": ("samples", "samples on straights with `error_m` above 0.12 m (R14)"),
    "violations_true": ("samples", "samples on straights with `error_true_m` above 0.12 m"),
    "rms_mu": ("-", "RMS error of the estimated μ"),
    "rms_kappa": ("-", "RMS error of the estimated κ"),
    "rms_yaw_rad": ("rad", "RMS error of the estimated yaw"),
    "mean_error_from_start_m": ("m", "mean of `error_m` over the whole run (R14)"),
    "overshoot_m": ("m", "on the first row: the largest distance beyond the path from the start"),
    "omega_peak_radps": ("rad/s", "largest absolute commanded yaw rate of the whole run"),
    "kkt_rhe_median": ("", "median of `kkt_rhe` (R12)"),
    "kkt_rhc_median": ("", "median of `kkt_rhc` (R12)"),
    "solver_ok": ("", "whether every QP was solved; it says nothing of the errors"),
}

_HEAD = """# Columns of a log

<!-- Made by `python -m rhec.simulation.log_page`, from the tables in that module. -->

Units are SI. Yaw is counter-clockwise from the x axis and unwrapped. `run.log` has one row for each
sample of 0.2 s. An encoder measurement belongs to the interval that ends at its row.

## A run: `run.log` of `rhec.simulate`
"""
_UNSOLVED = """
(1) The RHC's QP is given up after 257 guesses of its active set, and the previous plan goes on.
This happens where positions jump by much more than `sigma_v` allows and nothing rejects them. With
100 m of GNSS noise it happens in 2 of 3,600 samples at a horizon of 15, and in 11 to 13 % at
`prediction_horizon=240`. With 10 km it happens in 1 to 2 %, with 1,000 km in a quarter (seeds 0 to
2, 240 s each). Sixteen times as many guesses solve all at 100 m, but not from 10 km on, and a
sample may then take sixteen times as long.
"""
_RECORDING_HEAD = """
## A recording: the log of a real robot, for `rhec.replay`

Rows are at most 0.2 s apart. Other columns are ignored.
"""
_REPLAY_HEAD = """
## A replay: the table that `rhec.replay` returns

The names of a run mean the same. The flags `position_accepted`, `encoders_accepted` and `restarted`
are False in rows between the samples of the estimator. A recording's truth stands under the names
of a run.
"""
_MODEL = """
With a `model`, a recording has `t_s`, a column for each of the model's outputs and, optionally,
`segment`. The replay returns these and `ok`. It adds the estimate `<name>_hat` of each state, input
and parameter, and the standard deviation `<name>_sigma` of each state and parameter. The age of
each output when it was used is `<name>_age_s`, in seconds. The paper's robot keeps the names above,
with the unit last, because they are those of `run.log`; a Model's names are the user's own, so that
nothing is put into them.
"""
_METRICS_HEAD = """
## Metrics

`run.metrics`, and one column each in the table of `rhec.campaign`. Unless said otherwise they count
from the end of the 5 s that make the robot settled, or from the start of a run that never settles.
"""


def page():
    """The text of docs/log_columns.md."""
    runs = _columns_of("run")
    replays = {name: column for name, column in _columns_of("replay").items() if name not in runs}
    metrics = {name: Column(unit, text, ()) for name, (unit, text) in METRICS.items()}
    parts = (
        _HEAD,
        _rows("column", runs),
        _UNSOLVED,
        _RECORDING_HEAD,
        _rows("column", _columns_of("recording")),
        _REPLAY_HEAD,
        _rows("column", replays),
        _MODEL,
        _METRICS_HEAD,
        _rows("metric", metrics),
    )
    return "".join(parts)


def _columns_of(table):
    return {name: column for name, column in COLUMNS_BY_NAME.items() if table in column.tables}


def _rows(title, columns):
    """A Markdown table, in which neighbours with one unit and meaning share a row."""
    lines = ["", f"| {title} | unit | meaning |", "|---|---|---|"]
    for column, names in groupby(columns, columns.get):
        quoted = ", ".join(f"`{name}`" for name in names)
        lines.append(f"| {quoted} | {column.unit} | {column.text} |")
    return "\n".join(lines) + "\n"


# help(rhec.simulation.log_page) shows the page, too.
__doc__ += "\n" + page()

if __name__ == "__main__":
    print(page(), end="")
