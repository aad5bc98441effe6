"""Comparisons of chains of blocks in time with exact motions (derived).

Creep: contacts far below their threshold break by heat at one rate, 1, and form again
at once. The mean stretch f and, but for 1/n, the mean square q of those of a block obey

    f' = X' - f,    q' = 2 X' f - q,

so that the motion of a chain is linear, and breaks take q/2 from each contact.

Fronts: at T = 0 a plate pulls all blocks, and a spring the edge, so stiff that its block
breaks when the others have the prestress of a front of a known speed.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import integrate

from eqsim.engine.chain_records import ChainTrajectory, fronts_of
from eqsim.engine.trajectory import trajectory
from eqsim.estimate import Estimate, known
from eqsim.laws.thermal import Thermal
from eqsim.laws.threshold import Delta
from eqsim.master.chain_fronts import decay, front_prestress
from eqsim.model.chain import Chain
from eqsim.model.drive import Programme, Segment
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array
from eqsim.validation.comparison import Found, Point, compares
from eqsim.validation.points import Suite

# Stretch in creep over the threshold, so small that heat breaks all at one rate.
_SMALL = 1e-3
# Runs of a chain in creep, whose scatter is the error.
_RUNS = 16
# Barrier over k_B T of an unstretched contact.
_BARRIER = 2.0
# Contacts of a chain in creep.
_CREEPING = 6000
# Blocks that a front passes, and contacts of each.
_PASSED, _PER_BLOCK = 72, 256
# Velocity of the plate that loads them, over the position at which the edge breaks.
_SLOWLY = 1e-5
# Share of a speed that the steps leave open in which blocks break.
_STEPS = 0.005


class Creep(NamedTuple):
    """Linear motion of a chain, its L (blocks, blocks), and the share of the energy of
    breaks that counts."""

    chain: Chain
    laplacian: Array
    counted: float = 1.0

    def after(self, time: float, way: float) -> Array:
        """Means over blocks of X, of the force of contacts, and of the energy that
        breaks and dampers take, after a `time` in which the drive moves a `way`."""
        chain, size = self.chain, self.chain.count
        weights = chain.contacts_of(_CREEPING) / (_CREEPING / size)
        dampers = chain.damping * np.eye(size) + chain.bulk_damping * self.laplacian

        def motion(t: float, y: Array) -> Array:
            X, V, f, q = y[:-1].reshape(4, size)
            net = chain.springs * (way * t / time - X) - weights * f
            net = net - chain.coupling * self.laplacian @ X
            if chain.mass:
                change = (net - dampers @ V) / chain.mass
            else:
                V, change = np.linalg.solve(dampers, net), np.zeros(size)
            power = (V @ dampers @ V + 0.5 * self.counted * weights @ q) / size
            return np.concatenate((V, change, V - f, 2.0 * V * f - q, [power]))

        start, how = np.zeros(4 * size + 1), {"rtol": 1e-9, "atol": 1e-12 * way}
        found = integrate.solve_ivp(motion, (0.0, time), start, "LSODA", **how)
        X, _, f, _ = found.y[:-1, -1].reshape(4, size)
        return np.array([X.mean(), (weights * f).mean(), found.y[-1, -1]])


def creep_of(chain: Chain) -> Creep:
    """The linear motion of a chain with open edges."""
    beside = np.eye(chain.count, k=1) + np.eye(chain.count, k=-1)
    return Creep(chain, np.diag(chain.neighbours) - beside)


def compare_chain(point: Point, plan: Suite) -> Found:
    """A chain in creep or, at every fourth point, a front."""
    return (fronts if point.number % 4 == 3 else creep)(point, plan)


def contacts_of(number: int) -> Ensemble:
    """Identical contacts of a point, which heat breaks at the rate 1, or never, where
    a front is compared."""
    front = number % 4 == 3
    heat = Thermal(0.5 / _BARRIER, 1e-50 if front else math.exp(_BARRIER))
    count = _PASSED * _PER_BLOCK if front else _CREEPING
    return Ensemble(Delta(1.0), heat, count=count, stiffness_law="uniform")


def _run(point: Point, chain: Chain, *segments: Segment, run: int) -> ChainTrajectory:
    seed, drive = point.stream(11, run), Programme(segments, chain=chain)
    found = trajectory(point.shown, drive, points=2, seed=seed)
    assert isinstance(found, ChainTrajectory)
    return found


@compares("chain creep", "chain force", "chain energy")
def creep(point: Point, plan: Suite) -> Found:
    """Displacement, force, and energy taken, means over blocks, of a chain of 2 to 5
    blocks whose edge is pulled or whose loads differ, after one to three lifetimes of
    contacts. Errors include what finite steps change."""
    rng = point.rng(11)

    def drawn(low: float, high: float) -> float:
        return float(f"{10 ** rng.uniform(low, high):.4g}")

    size, drive = int(rng.integers(2, 6)), int(rng.integers(4))
    chain = Chain(
        size,
        coupling=drawn(-0.5, 1.0),
        drive_stiffness=drawn(-0.5, 0.5),
        drive=("edge", "both", "plate", "edge")[drive],
        edge_stiffness=drawn(-0.5, 0.5) if drive == 1 else None,
        load=tuple(rng.uniform(0.5, 2.0, size).tolist()) if drive == 2 else None,
        mass=float(rng.integers(2)) * drawn(-1.0, 0.3),
        damping=drawn(-0.5, 0.0),
        bulk_damping=float(rng.integers(2)) * drawn(-1.0, 0.0),
        tolerance=1e-3 * _SMALL,
    )
    time = drawn(0.0, 0.5)
    pull = Segment(_SMALL / time, time=time)
    values, steps = np.empty((_RUNS, 3)), np.empty((_RUNS, 3))
    for run in range(_RUNS):
        found = _run(point, chain, pull, run=run)
        X, step = float(found.X[-1]), float(found.X_stderr[-1])
        taken = float(found.energy[-1, 2:].sum())  # and missed
        values[run] = X, found.force[-1], taken
        # forces follow X with a stiffness of 1 or less, energies its square
        steps[run] = step, step, 2.0 * step / X * taken
    exact = creep_of(chain).after(time, _SMALL)
    bounds = np.hypot(steps.mean(axis=0), exact * [0.0, 0.0, size / _CREEPING])
    scatter = np.std(values, axis=0, ddof=1) / math.sqrt(_RUNS)
    point = point._replace(chain=chain, contacts=_CREEPING, time=time)
    scores: Found = []
    for i, kind in enumerate(creep.kinds):
        error = math.hypot(scatter[i], bounds[i])
        ours = Estimate(float(values[:, i].mean()), error, _RUNS, _RUNS - 1)
        scores.append(
            point.score(kind, ours, Estimate(float(exact[i]), 0.0, 0), bounds[i])
        )
    return scores


@compares("front")
def fronts(point: Point, plan: Suite) -> Found:
    """Speed of a front through the middle of a chain whose contacts form again at once,
    by the quoted error of the whole and that of steps, which are bounds. The plate
    moves on by a little until the edge breaks, and changes the prestress."""
    rng = point.rng(12)
    K, K_d = (float(10 ** rng.uniform(*ends)) for ends in ((0.7, 1.3), (-2, -1)))
    mass, held = float(point.number % 16 == 7), 1.0 + K_d
    speed = math.sqrt(K) * rng.uniform(0.6, 0.9)
    prestress, faster = (
        known(front_prestress(v, K, mass=mass, damping=1.0, drive_stiffness=K_d))
        for v in (speed, 1.01 * speed)
    )
    plate = prestress * held / K_d
    # the edge is displaced against the springs of its block and of all others
    edge = (held + K * (1.0 - decay(K, held))) * (1.0 - prestress) / (plate - 1.0)
    chain = Chain(
        _PASSED,
        K,
        K_d,
        drive="both",
        edge_stiffness=edge,
        mass=mass,
        damping=1.0,
        tolerance=1e-3,
    )
    loads = (0.98 * plate, 1), (0.04 * plate, 200)  # records, which steps do not pass
    pull = [Segment(_SLOWLY * plate, distance=d, points=n) for d, n in loads]
    found = _run(point, chain, *pull, run=0)
    late = prestress * (_SLOWLY * float(found.events["t"][0]) - 1.0)
    change = 0.01 * speed * late / (faster - prestress)
    middle = np.abs(found.broke["block"] - _PASSED // 2) < _PASSED // 4
    steady = fronts_of(
        {name: rows[middle] for name, rows in found.broke.items()}, chain
    )
    errors = found.fronts["speed_stderr"][0], steady["speed_stderr"][0]
    stderr = math.hypot(*errors, _STEPS * speed)
    point = point._replace(chain=chain, contacts=point.shown.count, time=found.t[-1])
    ours = Estimate(float(steady["speed"][0]), stderr, 0)
    exact = Estimate(speed + change, abs(change), 0)
    return [point.score("front", ours, exact, stderr)]


CHAIN_KINDS = (*creep.kinds, *fronts.kinds)
