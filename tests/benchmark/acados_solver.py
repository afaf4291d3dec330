"""acados on the benchmark's problems, in a process and an environment of its own.

`python acados_solver.py problems.npz folder`: builds its solvers in the folder, then answers each
line {"count": n, "begin": i} of its standard input with one line of JSON: with "iterations" the
answers after so many, else the microseconds that one real-time iteration a problem took. The
arrival cost, the weights and the windows are data, as for all others.
"""

import ctypes
import json
import os
import sys
import time

import casadi as ca
import numpy as np

try:
    from acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver
except ImportError:  # as the wheel has it
    import acados

    os.environ["ACADOS_SOURCE_DIR"], os.environ["TERA_PATH"] = acados.DIR, acados.TERA_PATH
    os.environ["ACADOS_PYTHON_INTERFACE_PATH"] = acados.TEMPLATE_DIR
    for library in ("libblasfeo.so", "libhpipm.so", "libqpOASES_e.so.3.1", "libacados.so"):
        ctypes.CDLL(os.path.join(acados.LIB_DIR, library), ctypes.RTLD_GLOBAL)
    from acados.acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

# The fastest of these on these problems is the one that is timed.
QP_SOLVERS = (
    "FULL_CONDENSING_DAQP",
    "FULL_CONDENSING_HPIPM",
    "PARTIAL_CONDENSING_HPIPM",
    "FULL_CONDENSING_QPOASES",
)
POSE_SPEED = np.eye(6)[[0, 1, 3]]  # of s = (x, y, θ, ν, μ, κ)


def runge_kutta(f, s, u, dt_s):
    k1 = f(s, u)
    k2 = f(s + dt_s / 2 * k1, u)
    k3 = f(s + dt_s / 2 * k2, u)
    k4 = f(s + dt_s * k3, u)
    return s + dt_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def track_motion(s, omega):
    forward = s[4] * s[3]
    return ca.vertcat(
        forward * ca.cos(s[2]), forward * ca.sin(s[2]), s[5] * omega, ca.SX.zeros(3, 1)
    )


def problem(name, data, qp_solver):
    """What both have in common: the robot, the horizon, real-time iterations."""
    ocp, model = AcadosOcp(), AcadosModel()
    s, omega = ca.SX.sym("s", 6), ca.SX.sym("omega")
    model.name, model.x, model.u = name, s, omega
    model.disc_dyn_expr = runge_kutta(track_motion, s, omega, float(data["dt_s"]))
    ocp.model, ocp.dims.N = model, len(data["omega_ref"][0])
    options = ocp.solver_options
    options.integrator_type, options.nlp_solver_type = "DISCRETE", "SQP_RTI"
    options.hessian_approx, options.qp_solver = "GAUSS_NEWTON", qp_solver
    options.qp_solver_warm_start, options.hpipm_mode = 1, "SPEED"
    options.tf = float(ocp.dims.N)  # costs are weighted by the length of a step: 1
    cost = ocp.cost
    cost.cost_type = cost.cost_type_0 = cost.cost_type_e = "LINEAR_LS"
    return ocp


def least_squares(ocp, stage, Vx, Vu, W):
    """½ ‖Vx s + Vu ω - yref‖² by W, of the stages "_0", "" or "_e"."""
    cost = ocp.cost
    setattr(cost, f"Vx{stage}", Vx)
    if stage != "_e":
        setattr(cost, f"Vu{stage}", np.array(Vu, float)[:, None])
    setattr(cost, f"W{stage}", W)
    setattr(cost, f"yref{stage}", np.zeros(len(Vx)))


class Estimator:
    """Measurement i + 1 belongs to node i + 1 and, as its yaw rate, to interval i."""

    def __init__(self, data, qp_solver, folder):
        self.data, self.N = data, len(data["omega_ref"][0])
        self.weights = np.diag(data["weights"])
        ocp = problem("rhe", data, qp_solver)
        first = np.vstack([np.eye(6), POSE_SPEED, np.zeros(6)])
        least_squares(ocp, "_0", first, [0] * 9 + [1], np.eye(10))
        within = np.vstack([POSE_SPEED, np.zeros(6)])
        least_squares(ocp, "", within, [0, 0, 0, 1], self.weights)
        least_squares(ocp, "_e", POSE_SPEED, [], self.weights[:3, :3])
        bounds = ocp.constraints
        bounds.idxbx_e, bounds.lbx_e, bounds.ubx_e = np.array([4, 5]), np.zeros(2), np.ones(2)
        self.solver = build(ocp, folder)
        for node in range(self.N + 1):
            self.solver.set(node, "x", data["estimate"][0])

    def give(self, k):
        z, solver, W = self.data["z"][k], self.solver, np.zeros((10, 10))
        W[:6, :6], W[6:, 6:] = self.data["H"][k], self.weights
        solver.cost_set(0, "W", W, api="new")
        solver.cost_set(0, "yref", np.concatenate([self.data["m"][k], z[:3, 0], z[3:, 1]]))
        for i in range(1, self.N):
            solver.cost_set(i, "yref", np.append(z[:3, i], z[3, i + 1]))
        solver.cost_set(self.N, "yref", z[:3, self.N])

    def answer(self):
        return self.solver.get(self.N, "x")


class Controller:
    def __init__(self, data, qp_solver, folder):
        self.data, self.N = data, len(data["omega_ref"][0])
        ocp = problem("rhc", data, qp_solver)
        pose, Q, R = np.eye(6)[:3], data["Q"], float(data["R"])
        W = np.diag([*np.diag(Q), R])
        for stage in ("_0", ""):
            least_squares(ocp, stage, np.vstack([pose, np.zeros(6)]), [0, 0, 0, 1], W)
        least_squares(ocp, "_e", pose, [], data["QN"])
        bounds, most = ocp.constraints, float(data["omega_max"])
        bounds.x0 = data["estimate"][0]
        bounds.idxbu, bounds.lbu, bounds.ubu = np.array([0]), np.array([-most]), np.array([most])
        self.solver = build(ocp, folder)

    def give(self, k):
        solver, estimate = self.solver, self.data["estimate"][k]
        solver.set(0, "lbx", estimate)
        solver.set(0, "ubx", estimate)
        xi_ref, omega_ref = self.data["xi_ref"][k], self.data["omega_ref"][k]
        for i in range(self.N):
            solver.cost_set(i, "yref", np.append(xi_ref[:, i], omega_ref[i]))
        solver.cost_set(self.N, "yref", xi_ref[:, self.N])

    def answer(self):
        return np.array([self.solver.get(i, "u")[0] for i in range(self.N)])


def build(ocp, folder):
    folder = os.path.join(folder, f"{ocp.model.name}_{ocp.solver_options.qp_solver}")
    os.makedirs(folder, exist_ok=True)
    os.chdir(folder)
    return AcadosOcpSolver(ocp, json_file="ocp.json")


def iterate(contestant):
    """Microseconds of one real-time iteration in C: preparation, feedback."""
    times = []
    for phase in (1, 2):
        contestant.solver.options_set("rti_phase", phase)
        status = contestant.solver.solve()
        if status not in (0, 2, 5):
            raise SystemExit(f"acados failed with status {status}")
        times.append(1e6 * float(np.ravel(contestant.solver.get_stats("time_tot"))[0]))
    return times


def solve(contestant, k, iterations):
    contestant.give(k)
    for _ in range(iterations):
        iterate(contestant)
    return contestant.answer()


def one_step(contestant, problems):
    """Microseconds a problem: preparation, feedback, and all of it from Python."""
    times = []
    for k in problems:
        begin = time.perf_counter()
        contestant.give(k)
        phases = iterate(contestant)
        contestant.answer()
        times.append([*phases, 1e6 * (time.perf_counter() - begin)])
    return np.mean(times, axis=0).tolist()


def fastest(kind, data, folder):
    """Of the QP solvers that are there."""
    made = {}
    for qp_solver in QP_SOLVERS:
        try:
            contestant = kind(data, qp_solver, folder)
            solve(contestant, 0, 20)
        except (Exception, SystemExit) as error:
            print(f"acados has no {qp_solver}: {error}", file=sys.stderr)
            continue
        problems = range(min(50, len(data["z"])))
        times = [sum(one_step(contestant, problems)[:2]) for _ in range(3)]
        made[min(times)] = contestant, qp_solver
    return made[min(made)]


def main():
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what acados prints is no answer
    data = dict(np.load(sys.argv[1]))
    folder = os.path.abspath(sys.argv[2])
    contestants, names = zip(*(fastest(kind, data, folder) for kind in (Estimator, Controller)))
    print(json.dumps(names), file=answers)
    for line in sys.stdin:
        asked = json.loads(line)
        problems = range(asked["begin"], asked["begin"] + asked["count"])
        if "iterations" in asked:
            reply = [
                [solve(c, k, asked["iterations"]).tolist() for c in contestants] for k in problems
            ]
        else:
            reply = [one_step(c, problems) for c in contestants]
        print(json.dumps(reply), file=answers)


if __name__ == "__main__":
    main()
