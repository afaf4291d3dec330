"""The generated C of an export as text: memory, phases, settings, README.txt.

The folder `c` contains the files that are the same in all exports.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.c_text import generate_c
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE
from rhec.embedded.exported_functions import operations

# Comments of the settings in C. Units of a Model are unknown.
_MEANING = {
    "V": "variances of the measurement noise, in the order of the outputs",
    "W": "variances of the process noise per sample",
    "Q": "weights of the states",
    "QN": "weights of the states at the end of the horizon",
    "R": "weights of the commanded inputs",
    "Q_y": "weights of the controller's outputs",
    "QN_y": "weights of the controller's outputs at the end of the horizon",
    "R_delta": "weights of the changes of the commanded inputs",
    "lower": "lower bounds: commanded inputs, then what else is bounded, what is soft last",
    "upper": "upper bounds, in the same order",
    "lower_N": "lower bounds at the end of the horizon",
    "upper_N": "upper bounds at the end of the horizon",
    "linear": "linear prices of soft bounds",
    "quadratic": "quadratic prices of soft bounds",
    "c": "constants of noise that grows with the motion",
    "m_0": "state of a restart where the model has no slopes",
    "P_0": "variances of a restart",
}
_MEANING_ON_A_PATH = _MEANING | {
    "V": "variances of measured x, y [m^2], nu [m^2/s^2], omega [rad^2/s^2], then of sensors",
    "segments": "of the path, in order: s, x, y [m], theta [rad], curvature [1/m] at the beginning",
    "period_m": "arc length after which the path repeats itself",
    "length_m": "arc length of the path",
    "look_ahead_m": "arc length from the robot to the first desired point",
    "backwards": "lambda: 1 for driving backwards",
    "Q": "weights of x, y, theta",
    "R": "weight of omega",
    "lower": "lower bound of the command omega [rad/s]",
    "upper": "upper bound of the command omega [rad/s]",
    "mean_traction": "constant mu, kappa of the estimator",
}
# CasADi branches on flags by a cast to int, which C leaves undefined for numbers that no int can
# hold. A flag is one only if memory was overwritten. The comparison is defined for all numbers, and
# is true where the cast is not 0.
_CAST_OF_A_FLAG = "#define casadi_to_int(x) ((casadi_int) x)"
_CHECK_OF_A_FLAG = "#define casadi_to_int(x) (!((x) > -1 && (x) < 1))"
# The parts of README.txt that differ.
_README_ON_A_PATH = dict(
    sources="rhec.c and rhec_scenario.c",
    source="the scenario in scenario.json",
    guess="guess",
    control="rhec_control(&r, &omega)",
    files="""\
    scenario.json                   all of the scenario
    replay.c, log.csv               example: replays a log, here {samples} samples of a run of
                                    the scenario with Python's results
    times.c, fuzz.c                 with a controller: measures the time of each phase on your
                                    machine (POSIX); feeds invalid sensor values, corrupts memory,
                                    checks the results
""",
    more="""\
Results agree with Python's to 1e-9 on x86-64 and 64-bit Arm; `replay log.csv` checks this on your
machine. Weights, variances and a path with the same number of segments can be changed without a new
export: copy rhec_scenario, change the copy, and pass it to rhec_init. The standard deviations of
the guess are {x_m:g} m in x and y, {theta_rad:g} rad in yaw, {nu_mps:g} m/s, {mu:g} in mu and
{kappa:g} in kappa, except for a user-defined estimator.
""",
)
_README_OF_A_MODEL = dict(
    sources="rhec.c and rhec_scenario.c",
    source="a model of a robot",
    guess="rhec_scenario_guess",
    control="rhec_control(&r, x, p, x_ref, u_ref, u)",
    files="",
    more="""\
Weights, variances, bounds and their prices can be changed without a new export: copy
rhec_scenario, change the copy, and pass it to rhec_init. If the controller has outputs, their
desired values are r.controller.y_ref, at first 0. If the estimator has process noise within its
window, W of the copy may change before each call of rhec_estimate: it is that of the newest
interval.
""",
)
_README_OF_A_LOG = dict(
    sources="rhec.c, search.c and rhec_scenario.c",
    source="the estimator that rhec log judged on a recorded log",
    guess="rhec_scenario_guess",
    control="",
    files="""\
    search.h, search.c              the same for an unknown first yaw, as it was judged
    scenario.json                   all parameters of the estimator
    replay.c, log.csv               example: replays a log, here {samples} samples of the log that
                                    was judged, with Python's results
""",
    more="""\
Results agree with Python's to 1e-9 on x86-64; `replay log.csv` checks this on your machine. The
noise, the guess of the antenna's place and all else are those that were judged. A robot that does
not know its first yaw calls rhec_search_init once and rhec_search_estimate each sample (search.h):
RHEC_HEADINGS times the memory and the time, until the yaw is found. One that knows it puts x, y and
yaw into a copy of rhec_scenario_guess and calls rhec_init and rhec_estimate alone.

The standard deviations of rhec_sigma are {inflation:.3g} times the estimator's own, by the
positions that rhec log hid. That of the yaw may still be too small where the robot slips sideways
for seconds: rhec log sees it in the course, which the C does not follow. Nor has the C its check of
a gyro that repeats itself or turns far more than the tracks: pass NaN for such a sample.
""",
)
_ALWAYS = "r->settings != 0"  # always true; avoids the warning about an unused argument
_DOUBLE_BYTES = 8
_HEAD = "/* Generated by rhec; do not edit. SPDX-License-Identifier: MIT */\n"
# CasADi's Functions have parameters and helpers that some of them do not use.
_FOR_ONE_FILE = """#define CASADI_SYMBOL_EXPORT static
#ifdef __GNUC__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter"
#pragma GCC diagnostic ignored "-Wunused-function"
#endif
"""


def memory_header(export):
    """rhec_memory.h: sizes, and the structs of the settings and of the memory."""
    parts = [
        _HEAD + "#ifndef RHEC_MEMORY_H\n#define RHEC_MEMORY_H\n",
        *_size_macros(export),
        "",
        *_settings_struct(export),
        "",
        *_memory_struct(export),
        "",
        "/* sizeof(struct rhec) where pointers have 8 bytes */",
        f"#define RHEC_MEMORY_BYTES {_bytes_of_memory(export)}",
        "\n#endif\n",
    ]
    return "\n".join(parts)


def _size_macros(export):
    """Lines that define the sizes and the components of the export."""
    macros = [
        f"#define RHEC_{name} {value!r} /* {note} */"
        for name, (value, note) in export.macros.items()
    ]
    if export.variances:
        n = int(np.sqrt(export.memory["estimator.covariance"]))
        macros.append(f"#define RHEC_COVARIANCE {n} /* rows of the covariance */")
        note = "factor of the standard deviations"
        macros.append(f"#define RHEC_INFLATION {export.inflation!r} /* {note} */")
    note = "largest plausible number in memory"
    largest = f"#define RHEC_MAX_PLAUSIBLE {MAX_PLAUSIBLE_STATE:g} /* {note} */"
    return [*macros, largest]


def _settings_struct(export):
    """Lines of struct rhec_settings."""
    meanings = _MEANING_ON_A_PATH if "PATH" in export.macros else _MEANING
    lines = ["struct rhec_settings {"]
    for name, value in export.settings.items():
        comment = f" /* {meanings[name]} */" if name in meanings else ""
        lines.append(f"    double {name}[{value.size}];{comment}")
    return [*lines, "};"]


def _memory_struct(export):
    """Lines of struct rhec."""
    shared = {place: size for place, size in export.memory.items() if "." not in place}
    lines = [
        "struct rhec {",
        "    const struct rhec_settings *settings;",
        "    int estimator_stage, controller_stage, predicted, restarted;",
        *_arrays(shared, 1),
    ]
    for owner in _owners(export):
        places = _below(export.memory, owner)
        twice = _below(places, "previous")
        lines.append("    struct {")
        if twice:
            lines += ["        struct {", *_arrays(twice, 3), "        } previous, current;"]
        lines += _arrays({name: size for name, size in places.items() if "." not in name}, 2)
        lines.append(f"    }} {owner};")
    w, iw = _work(export)
    lines.append(f"    double w[{w}]; /* work space of CasADi's Functions */")
    lines.append(f"    int iw[{iw}];")
    return [*lines, "};"]


def _owners(export):
    """The owners of memory: estimator, controller, path."""
    return list(dict.fromkeys(place.split(".")[0] for place in export.memory if "." in place))


def _below(memory, owner):
    """{name: size} of the places of an owner."""
    inside = (place for place in memory if place.startswith(f"{owner}."))
    return {place.removeprefix(f"{owner}."): memory[place] for place in inside}


def _arrays(sizes, depth):
    """Lines that declare arrays of doubles."""
    return [f"{'    ' * depth}double {name}[{size}];" for name, size in sizes.items()]


def _work(export):
    """Lengths of the real and the integer work space of CasADi's Functions."""
    functions = [phase.function for phase in export.phases.values()]
    return max(1, *(f.sz_w() for f in functions)), max(1, *(f.sz_iw() for f in functions))


def _bytes_of_memory(export):
    """sizeof(struct rhec) where pointers have 8 bytes."""
    w, iw = _work(export)
    doubles = w + 1  # the pointer to the settings has the size of a double
    for place, size in export.memory.items():
        if ".previous." in place:
            doubles += 2 * size  # `previous` and `current` are the same struct
        elif ".current." not in place:
            doubles += size
    integers = 4 + iw  # stages, counters and work space
    return _DOUBLE_BYTES * (doubles + (integers + 1) // 2)


def phases_header(export):
    """rhec_phases.h: a C function for each phase, and checks of its results."""
    parts = [_HEAD + '#include "rhec_functions.h"\n']
    for name, (f, reads, writes) in export.phases.items():
        # CasADi expects a null pointer for an empty argument or result.
        arguments = [f"r->{reads[arg]}" if f.nnz_in(arg) else "0" for arg in reads]
        results = [f"r->{writes[res]}" if f.nnz_out(res) else "0" for res in writes]
        parts.append(
            f"static void {name}(struct rhec *r)\n{{\n"
            f"    const double *arg[{f.sz_arg()}] = {{{', '.join(arguments)}}};\n"
            f"    double *res[{f.sz_res()}] = {{{', '.join(results)}}};\n"
            f"    {f.name()}(arg, res, r->iw, r->w, 0);\n}}\n"
        )
    for owner in (owner for owner in _owners(export) if f"{owner}_start" in export.phases):
        names = (f"{owner}_{name}" for name in ("expand", "linearise"))
        parts += [
            f"static void {name}(struct rhec *r)\n{{\n    (void)r;\n}}\n"
            for name in names
            if name not in export.phases
        ]
        ok = f"r->{owner}.ok[0] == 1" if f"{owner}.ok" in export.memory else _ALWAYS
        plausible = " && ".join(
            f"are_plausible(r->{place}, {export.memory[place]})"
            for place in _always_numbers(export, owner)
        )
        for check, condition in (("ok", ok), ("is_plausible", plausible or _ALWAYS)):
            head = f"static int {owner}_{check}(const struct rhec *r)"
            parts.append(f"{head}\n{{\n    return {condition};\n}}\n")
    return "\n".join(parts)


def _always_numbers(export, owner):
    """Places of an owner's memory that are never NaN, unlike a window of measurements."""
    start = export.phases[f"{owner}_start"]
    values = start.function.call([ca.DM.zeros(start.function.size_in(0))])
    return [place for place, value in zip(start.writes.values(), values) if value.is_regular()]


def scenario_source(export):
    """rhec_scenario.c: the settings and the guess as constants."""

    def braced(values):
        return "{" + ", ".join(map(repr, values.ravel(order="F").tolist())) + "}"

    variances = ", ".join(map(str, export.variances))
    of_sigma = f"\nconst int rhec_variances[RHEC_ESTIMATE] = {{{variances}}};\n"
    fields = "".join(f"    .{name} = {braced(value)},\n" for name, value in export.settings.items())
    return (
        f'{_HEAD}#include "rhec.h"\n\n'
        f"const struct rhec_settings rhec_scenario = {{\n{fields}}};\n\n"
        f"const double rhec_scenario_guess[{export.guess.size}] = {braced(export.guess)};\n"
        f"{of_sigma if export.variances else ''}"
    )


def functions_header(export):
    """rhec_functions.h: the Functions by CasADi's code generator, included only by rhec.c."""
    functions = [phase.function for phase in export.phases.values()]
    text = generate_c(functions, "rhec_functions.c", casadi_int="int")
    text = text.replace(_CAST_OF_A_FLAG, _CHECK_OF_A_FLAG)
    end = "#ifdef __GNUC__\n#pragma GCC diagnostic pop\n#endif\n"
    return _HEAD + _FOR_ONE_FILE + text + end


def readme(export, template, **values):
    """README.txt: the template, filled in."""
    n_constants = sum(value.size for value in export.settings.values()) + export.guess.size
    dt_s, _ = export.macros["DT_S"]
    sizes = dict(
        dt_ms=1000 * dt_s, memory=_bytes_of_memory(export), constants=_DOUBLE_BYTES * n_constants
    )
    texts = _README_ON_A_PATH if "PATH" in export.macros else _README_OF_A_MODEL
    texts = _README_OF_A_LOG if export.is_of_log else texts
    has_controller = "CONTROLLER" in export.macros
    sizes |= dict(
        prepare=", rhec_prepare_control(&r)" if has_controller else "",
        control=f", {texts['control']}" if has_controller else "",
        **_most_operations(export),
    )
    texts = {name: text.format(**values) for name, text in texts.items() if name != "control"}
    return template.format(**sizes, **texts).rstrip("\n") + "\n"


def _most_operations(export):
    """Most scalar operations of the preparation and of the feedback of a sample, by name."""
    phases = {name: operations(phase.function) for name, phase in export.phases.items()}

    def most(*ends):
        return sum(count for name, count in phases.items() if name.endswith(ends))

    return dict(
        preparing=most("_expand", "_shift", "_linearise", "_move"),
        feeding=most("_feedback", "_follow", "_closest", "_first", "_start"),
    )
