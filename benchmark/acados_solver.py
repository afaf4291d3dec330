"""acados on the benchmark's problems, in a process and an environment of its own.

`python acados_solver.py problems.npz folder`: builds solvers in the folder, chooses the fastest
that find the answers, and prints the ways to call them and the choice; then it answers each line
{"way": one of those ways, "begin": i, "end": k} of its standard input with one line of JSON: with
"iterations" the answers after so many, else the microseconds of one real-time iteration; with
"library" callgrind counts them as "name". With the choice of an earlier process as a third argument
nothing is built. The arrival cost, the weights and the windows are data, as for all others.
"""

import contextlib
import ctypes
import itertools
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from benchmark import models

try:
    from acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

    ACADOS, WHEEL = Path(os.environ["ACADOS_SOURCE_DIR"]), False
except ImportError:  # as the wheel has it
    import acados

    ACADOS, WHEEL = Path(acados.DIR), True
    os.environ["ACADOS_SOURCE_DIR"], os.environ["TERA_PATH"] = acados.DIR, acados.TERA_PATH
    os.environ["ACADOS_PYTHON_INTERFACE_PATH"] = acados.TEMPLATE_DIR
    for library in ("libblasfeo.so", "libhpipm.so", "libqpOASES_e.so.3.1", "libacados.so"):
        ctypes.CDLL(os.path.join(acados.LIB_DIR, library), ctypes.RTLD_GLOBAL)
    from acados.acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

# What is tried: options to build with, and for HPIPM options of the call. What finds the first
# answers, to a tenth of the tolerance, and is fastest is what is timed, once it finds them all.
BUILDS = (
    dict(qp_solver="FULL_CONDENSING_DAQP"),
    dict(qp_solver="FULL_CONDENSING_QPOASES"),
    *(
        dict(qp_solver="FULL_CONDENSING_HPIPM", hpipm_mode=mode)
        for mode in ("SPEED_ABS", "SPEED", "BALANCE")
    ),
    *(
        dict(qp_solver="PARTIAL_CONDENSING_HPIPM", hpipm_mode="SPEED_ABS", qp_solver_cond_N=blocks)
        for blocks in (3, 10, 40)
    ),
)
MOST_CONDENSED = 60  # intervals; with more a condensed problem takes too long to be tried
WARM_STARTS, QP_TOLERANCES = (0, 1, 2, 3), (1e-6, 1e-8, 1e-10)
TOLERANCES = ("qp_tol_stat", "qp_tol_eq", "qp_tol_ineq", "qp_tol_comp")
SOME, ITERATIONS, ROUNDS, FINALISTS = 20, 30, 5, 6


class System:
    """The case that the problems are of, read from their data."""

    def __init__(self, data):
        self.n_x, self.N = data["x_ref"].shape[1], data["u_ref"].shape[-1]
        self.n_s = data["m"].shape[1]
        self.C = np.eye(self.n_s)[data["measured"]]
        self.V = np.diag(data["weights"])
        f = models.SYSTEMS[str(data["system"])]
        self.s, self.u = ca.SX.sym("s", self.n_s), ca.SX.sym("u")
        x, p = self.s[: self.n_x], self.s[self.n_x :]
        after = models.runge_kutta(f, x, self.u, p, float(data["dt_s"]))
        self.next = ca.vertcat(after, p)

    def problem(self, name, build):
        """What both have in common: the system, the horizon, real-time iterations."""
        ocp, model = AcadosOcp(), AcadosModel()
        model.name, model.x, model.u = name, self.s, self.u
        model.disc_dyn_expr = self.next
        ocp.model, ocp.dims.N = model, self.N
        options = ocp.solver_options
        options.integrator_type, options.nlp_solver_type = "DISCRETE", "SQP_RTI"
        options.hessian_approx = "GAUSS_NEWTON"
        options.tf = float(self.N)  # costs are weighted by the length of a step: 1
        for name, value in build.items():
            setattr(options, name, value)
        cost = ocp.cost
        cost.cost_type = cost.cost_type_0 = cost.cost_type_e = "LINEAR_LS"
        return ocp


def least_squares(ocp, stage, Vx, Vu, W):
    """½ ‖Vx s + Vu u - yref‖² by W, of the stages "_0", "" or "_e"."""
    cost = ocp.cost
    setattr(cost, f"Vx{stage}", Vx)
    if stage != "_e":
        setattr(cost, f"Vu{stage}", np.array(Vu, float)[:, None])
    setattr(cost, f"W{stage}", W)
    setattr(cost, f"yref{stage}", np.zeros(len(Vx)))


# Both problems: the optimal control problem; what each problem gives to its stages, as (stage,
# field, one row a problem); and which answer is looked at.


def estimation(data, build):
    """Measurement i + 1 belongs to node i + 1 and, as its input, to interval i."""
    system = System(data)
    ocp, n_s, N = system.problem("rhe", build), system.n_s, system.N
    C, V = system.C, system.V
    n_y = len(C)
    nothing = np.zeros(n_s)
    first = np.vstack([np.eye(n_s), C, nothing])
    least_squares(ocp, "_0", first, [0] * (n_s + n_y) + [1], np.eye(n_s + n_y + 1))
    least_squares(ocp, "", np.vstack([C, nothing]), [0] * n_y + [1], V)
    least_squares(ocp, "_e", C, [], V[:n_y, :n_y])
    bounds = ocp.constraints
    bounds.idxbx_e, (bounds.lbx_e, bounds.ubx_e) = data["bounded"], data["bounds"].T

    z, m = data["z"], data["m"]
    W = np.zeros((len(z), n_s + n_y + 1, n_s + n_y + 1))
    W[:, :n_s, :n_s], W[:, n_s:, n_s:] = data["H"], V
    given = [(0, "W", W), (0, "yref", np.hstack([m, z[:, :n_y, 0], z[:, n_y:, 1]]))]
    given += [(i, "yref", np.hstack([z[:, :n_y, i], z[:, n_y:, i + 1]])) for i in range(1, N)]
    return ocp, [*given, (N, "yref", z[:, :n_y, N])], lambda solver: solver.get(N, "x")


def control(data, build):
    system = System(data)
    ocp, n_x, N = system.problem("rhc", build), system.n_x, system.N
    state, Q, R = np.eye(system.n_s)[:n_x], np.diag(data["q"]), float(data["r"])
    for stage in ("_0", ""):
        W = np.diag([*data["q"], R])
        least_squares(ocp, stage, np.vstack([state, np.zeros(system.n_s)]), [0] * n_x + [1], W)
    least_squares(ocp, "_e", state, [], float(data["qn_factor"]) * Q)
    bounds, most = ocp.constraints, float(data["u_max"])
    bounds.x0 = data["estimate"][0]
    bounds.idxbu, bounds.lbu, bounds.ubu = np.array([0]), np.array([-most]), np.array([most])

    x_ref, u_ref = data["x_ref"], data["u_ref"][:, 0]
    given = [(0, field, data["estimate"]) for field in ("lbx", "ubx")]
    given += [(i, "yref", np.hstack([x_ref[:, :, i], u_ref[:, [i]]])) for i in range(N)]
    given += [(N, "yref", x_ref[:, :, N])]
    return ocp, given, lambda solver: np.array([solver.get(i, "u")[0] for i in range(N)])


PROBLEMS = {"estimate": estimation, "plan": control}  # by the name of the answer


def compiled_driver(folder):
    library, include = Path(folder, "acados_driver.so"), ACADOS / "include"
    header = (include / "acados_c" / "ocp_nlp_interface.h").read_text()
    bounds_take_out = re.search(r"ocp_nlp_constraints_model_set\([^)]*ocp_nlp_out", header)
    command = ["cc", "-O2", "-shared", "-fPIC", "-fno-inline", *["-DSTEP_BY_STEP"] * WHEEL]
    command += [f"-DBOUNDS_TAKE_OUT={'a->out,' if bounds_take_out else ''}"]
    command += [f"-I{include / part}" for part in ("", "blasfeo/include", "hpipm/include")]
    command += [Path(__file__).with_name("acados_driver.c"), "-o", library]
    command += [f"-L{ACADOS / 'lib'}", f"-Wl,-rpath,{ACADOS / 'lib'}", "-lacados"]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(library))


class Contestant:
    """A solver of one of the problems, built in `folder` unless it is there already."""

    def __init__(self, answer, data, build, folder, driver):
        ocp, given, self._answer = PROBLEMS[answer](data, build)
        name = ocp.model.name
        folder = Path(folder, "_".join([name, *map(str, build.values())]))
        new = not folder.exists()
        folder.mkdir(exist_ok=True)
        os.chdir(folder)
        self.solver = AcadosOcpSolver(ocp, json_file="ocp.json", generate=new, build=new)
        library, self._drive = self.solver.shared_lib, driver.drive

        def part(which):
            get = getattr(library, f"{name}_acados_get_nlp_{which}")
            get.restype, get.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
            return get(self.solver.capsule)

        parts, capsule = [part(which) for which in ("solver", "in", "out")], self.solver.capsule
        capsule = getattr(capsule, "value", capsule)
        solve = ctypes.cast(getattr(library, f"{name}_acados_solve"), ctypes.c_void_p).value
        self.ways = {"as it comes": np.array([*parts, solve, capsule], np.int64)}
        if WHEEL:
            self.ways["step by step"] = np.array([*parts, 0, capsule], np.int64)
        self._alive = [
            (ctypes.create_string_buffer(field.encode()), np.ascontiguousarray(rows, float))
            for _, field, rows in given
        ]
        self._fields = np.array(
            [
                (ctypes.addressof(field), rows.ctypes.data, stage, rows[0].size)
                for (stage, *_), (field, rows) in zip(given, self._alive)
            ],
            np.int64,
        )
        if answer == "estimate":
            for node in range(ocp.dims.N + 1):
                self.solver.set(node, "x", data["estimate"][0])
        self.run("as it comes", 0, 1)  # its steps need what a first call lays out

    def run(self, way, begin, end, iterations=1):
        """Microseconds of preparation and feedback, summed over these problems."""
        us = np.zeros(2)
        arrays = (self.ways[way], self._fields, us)
        solver, fields, to = (ctypes.c_void_p(array.ctypes.data) for array in arrays)
        counts = map(ctypes.c_longlong, (len(self._fields), begin, end, iterations))
        failed = self._drive(solver, fields, *counts, to)
        if failed:
            raise RuntimeError(f"acados failed with status {failed}")
        return us

    def answers(self, way, begin, end, iterations):
        found = []
        for k in range(begin, end):
            self.run(way, k, k + 1, iterations)
            found.append(self._answer(self.solver))
        return np.array(found)

    def use(self, options):
        for name, value in options.items():
            self.solver.options_set(name, value)


def choices(build):
    if "HPIPM" not in build["qp_solver"]:
        return [{}]
    return [
        dict(qp_warm_start=warm, **dict.fromkeys(TOLERANCES, tolerance))
        for warm, tolerance in itertools.product(WARM_STARTS, QP_TOLERANCES)
    ]


def fastest(answer, data, folder, driver):
    """(build, options) of what takes least time of what finds all answers.

    The best of a first round take turns, since the machine has slow moments.
    """
    library, found, end = ctypes.CDLL(str(ACADOS / "lib" / "libacados.so")), [], len(data[answer])
    some = min(SOME, end)

    def took(contestant, options, count):
        contestant.use(options)
        return contestant.run(list(contestant.ways)[-1], 0, count).sum()

    intervals = data["u_ref"].shape[-1]
    for build in BUILDS:
        if build.get("qp_solver_cond_N", 0) > intervals:
            continue
        if "FULL" in build["qp_solver"] and intervals > MOST_CONDENSED:
            continue
        if "DAQP" in build["qp_solver"] and not hasattr(library, "dense_qp_daqp"):
            continue
        contestant = Contestant(answer, data, build, folder, driver)
        for options in choices(build):
            contestant.use(options)
            with contextlib.suppress(RuntimeError):  # acados failed
                answers = contestant.answers(list(contestant.ways)[-1], 0, some, ITERATIONS)
                if np.abs(answers - data[answer][:some]).max() <= data["tolerance"] / 10:
                    us = min(took(contestant, options, some) for _ in range(ROUNDS))
                    found.append((us, build, contestant, options))
    best = sorted(found, key=lambda each: each[0])[:FINALISTS]
    if not best:
        raise SystemExit(f"no setting of its QP solvers found the answers of {answer}")
    rounds = [[took(*each[2:], end) for each in best] for _ in range(ROUNDS)]
    _, build, _, options = best[np.argmin(np.min(rounds, axis=0))]
    return build, options


def main():
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what acados prints is no answer
    data, folder = dict(np.load(sys.argv[1])), os.path.abspath(sys.argv[2])
    driver = compiled_driver(folder)
    chosen = (
        json.loads(sys.argv[3])
        if sys.argv[3:]
        else [fastest(answer, data, folder, driver) for answer in PROBLEMS]
    )
    contestants = []
    for answer, (build, options) in zip(PROBLEMS, chosen):
        contestants.append(Contestant(answer, data, build, folder, driver))
        contestants[-1].use(options)
    print(json.dumps([list(contestants[0].ways), chosen]), file=answers)
    for line in sys.stdin:
        asked = json.loads(line)
        which = asked["way"], asked["begin"], asked["end"]
        if "iterations" in asked:
            found = (c.answers(*which, asked["iterations"]).tolist() for c in contestants)
            reply = list(zip(*found))
        elif "library" in asked:
            counting = ctypes.CDLL(asked["library"])
            for problem, contestant in zip(("RHE", "RHC"), contestants):
                contestant.answers(asked["way"], 0, asked["begin"], 1)
                counting.begin()
                contestant.run(*which)
                counting.end(f"{asked['name']}/{problem}".encode())
            reply = None
        else:
            reply = [
                (c.run(*which) / (asked["end"] - asked["begin"])).tolist() for c in contestants
            ]
        print(json.dumps(reply), file=answers)


if __name__ == "__main__":
    main()
