r"""Measure the membrane mechanics: time and accuracy on the simulator, and alternative solvers.

    .venv/bin/python scripts/measure_mechanics.py [time] [solvers]

Default: time. The paper (Yin et al.) reports 0.3 s per frame for a mesh of about 440 nodes. Times are
medians over the frames of one press, on one thread; processor time does not depend on the machine's load.
Solvers that Tactune does not use are compared if they are installed, for example by

    .venv/bin/uv pip install --target build/solvers osqp clarabel proxsuite
    PYTHONPATH=build/solvers:build/solvers/cmeel.prefix/lib/python3.11/site-packages \
        .venv/bin/python scripts/measure_mechanics.py solvers
"""

from __future__ import annotations

import importlib
import importlib.metadata
import statistics
import sys
import time

import numpy as np
from scipy import sparse

from tactune.core.evaluation.metrics import cloud_distances, truth_cloud
from tactune.core.methods.mechanics import MembraneMechanics
from tactune.core.methods.mechanics_problem import MembraneSolver
from tactune.core.preset import Preset
from tactune.core.sources.simulator.source import SimulatorSource

NODES = (440, 1000, 2000)
#: Frames of a press; the first one is the untouched frame.
PRESSED = range(6, 42, 2)
PAPER_MS = 300.0


def measure_time():
    """Time of a whole frame and of the solver in it, and the patch's error, for meshes of three sizes."""
    for scene in ("cup", "cube", "octopus"):
        source = SimulatorSource(scene=scene)
        frames = [source.read(index) for index in PRESSED]
        for nodes in NODES:
            method = MembraneMechanics(Preset(), source.rig, source.read(0), nodes=nodes)
            method.find(frames[0])
            whole, solving, errors = [], [], []
            for frame in frames:
                whole.append(timed(method.find, frame))
                solving.append(timed(method.solve, method.way_m(frame.tactile_depth)))
                found = cloud_distances(method.find(frame).points, truth_cloud(frame.truth, source.rig).points)
                errors.append(1e3 * found.symmetric_rmse_m)
            wall, processor = medians(whole)
            print(
                f"{scene:8s} {len(method.problem.mesh.pixels):5d} nodes: {wall:6.1f} ms a frame "
                f"({processor:.1f} ms of processor, {medians(solving)[1]:.1f} of it the solver; "
                f"{PAPER_MS / wall:.0f} times the paper's), RMSE {np.nanmedian(errors):.2f} mm"
            )


def measure_solvers():
    """Median time, steps and worst optimality residual of each solver, warm-started if possible."""
    source = SimulatorSource(scene="cup")
    for nodes in NODES[:2]:
        method = MembraneMechanics(Preset(), source.rig, source.read(0), nodes=nodes)
        programs = [
            method.problem.program(method.way_m(source.read(index).tactile_depth)) for index in (*PRESSED, *PRESSED)
        ]
        print(f"{nodes} nodes: {len(programs[0].q)} variables, {programs[0].A.shape[0]} equations")
        for name, make in (("piqp", PIQP), ("osqp", OSQP), ("clarabel", Clarabel), ("proxsuite", ProxQP)):
            try:
                importlib.import_module(name)
            except ImportError:
                print(f"  {name}: not installed")
                continue
            solver = make(programs[0])
            results = []
            times = [timed(lambda s=solver, p=program, r=results: r.append(s.solve(p))) for program in programs]
            worst = max(residual(program, *result[:3]) for program, result in zip(programs, results, strict=True))
            steps = [result[3] for result in results]
            print(
                f"  {name + ' ' + importlib.metadata.version(name):16s} {medians(times)[1]:7.1f} ms "
                f"(slowest {1e3 * max(t[1] for t in times):.1f}), steps {min(steps)}-{max(steps)}, "
                f"worst residual {worst:.0e}"
            )


class PIQP:
    """As Tactune uses it."""

    def __init__(self, first):
        self.solver = MembraneSolver(first)

    def solve(self, program):
        """Return x, the multipliers of equations and bounds, and the steps."""
        solution = self.solver.solve(program)
        return solution.x, solution.balance, solution.bound, solution.steps


class OSQP:
    """Factorised once, and again when the set of visible nodes changes; warm-started, polished."""

    def __init__(self, first):
        import osqp

        # stored zeros are dropped by its setup
        P = first.P + 1e-12 * sparse.eye_array(len(first.q), format="csc")
        self.seen = first.P.diagonal()
        count = first.positive.stop - first.positive.start
        rows, zeros = sparse.vstack([first.A, picks(first)]).tocsc(), np.zeros(first.A.shape[0])
        self.solver = osqp.OSQP()
        self.solver.setup(
            sparse.csc_matrix(P), first.q, sparse.csc_matrix(rows), np.concatenate([zeros, np.zeros(count)]),
            np.concatenate([zeros, np.full(count, np.inf)]), eps_abs=1e-7, eps_rel=1e-7, max_iter=20_000,
            polishing=True, verbose=False,
        )  # fmt: skip

    def solve(self, program):
        """Return x, the multipliers of equations and bounds, and the steps."""
        diagonal = program.P.diagonal()
        if np.array_equal(diagonal, self.seen):
            self.solver.update(q=program.q)
        else:
            self.solver.update(q=program.q, Px=diagonal)
            self.seen = diagonal
        result = self.solver.solve()
        return result.x, result.y[: program.A.shape[0]], -result.y[program.A.shape[0] :], result.info.iter


class Clarabel:
    """Analysed once; an interior-point method has no warm start."""

    def __init__(self, first):
        import clarabel

        settings = clarabel.DefaultSettings()
        settings.verbose = settings.presolve_enable = False
        settings.max_threads = 1
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
        count = first.positive.stop - first.positive.start
        rows = sparse.vstack([first.A, -picks(first)]).tocsc()
        cones = [clarabel.ZeroConeT(first.A.shape[0]), clarabel.NonnegativeConeT(count)]
        self.solver = clarabel.DefaultSolver(first.P, first.q, rows, np.zeros(rows.shape[0]), cones, settings)

    def solve(self, program):
        """Return x, the multipliers of equations and bounds, and the steps."""
        self.solver.update(P=program.P, q=program.q)
        result = self.solver.solve()
        multipliers, count = np.array(result.z), program.A.shape[0]
        return np.array(result.x), multipliers[:count], multipliers[count:], result.iterations


class ProxQP:
    """Warm-started from the previous frame."""

    def __init__(self, first):
        from proxsuite import proxqp

        count = first.positive.stop - first.positive.start
        self.solver = proxqp.sparse.QP(len(first.q), first.A.shape[0], count)
        self.solver.settings.eps_abs = 1e-8
        self.solver.settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        zeros = np.zeros(first.A.shape[0])
        self.solver.init(first.P, first.q, first.A, zeros, picks(first), np.zeros(count), np.full(count, 1e20))

    def solve(self, program):
        """Return x, the multipliers of equations and bounds, and the steps."""
        self.solver.update(H=program.P, g=program.q)
        self.solver.solve()
        result = self.solver.results
        return np.array(result.x), np.array(result.y), -np.array(result.z), result.info.iter


def picks(program):
    """Return the matrix that picks the variables with a bound."""
    return sparse.eye_array(len(program.q), format="csr")[program.positive]


def residual(program, x, balance, bound):
    """Return the largest violation of the optimality conditions."""
    multiplier = np.zeros(len(x))
    multiplier[program.positive] = bound
    pressure = x[program.positive]
    stationary = program.P @ x + program.q + program.A.T @ balance - multiplier
    return max(
        np.abs(stationary).max(),
        np.abs(program.A @ x).max(),
        -pressure.min(),
        -bound.min(),
        np.abs(pressure * bound).max(),
    )


def timed(work, *arguments):
    """Return seconds of wall and of processor."""
    wall, processor = time.perf_counter(), time.process_time()
    work(*arguments)
    return time.perf_counter() - wall, time.process_time() - processor


def medians(times):
    """Return the median milliseconds of wall and of processor."""
    return tuple(1e3 * statistics.median(part) for part in zip(*times, strict=True))


if __name__ == "__main__":
    chosen = sys.argv[1:] or ["time"]
    for part in chosen:
        {"time": measure_time, "solvers": measure_solvers}[part]()
