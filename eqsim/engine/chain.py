"""Chains of blocks in time: their trajectories, with errors of finite steps.

Every chain is followed a second time in steps four times as long, as a slider behind a
stage is (`engine.slider_runs`). Threads share the blocks of a chain where these are
many, and the runs of replicas otherwise.
"""

import math
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import splu

from eqsim.engine.blocks import Progress, Threads, require_records, workers_of
from eqsim.engine.chain_records import ChainTrajectory, fronts_of, missing_steps
from eqsim.engine.chain_steps import (
    BROKE,
    COURSE,
    EVENT,
    Blocks,
    Chained,
    Links,
    begin_step,
    end_step,
    follow_all,
    follow_share,
    march,
)
from eqsim.engine.contacts import contacts
from eqsim.engine.keeping import Keep, State
from eqsim.engine.lattice import balance_of
from eqsim.engine.records import by_replica
from eqsim.engine.slider import BLOCK, CONTACT, FIRST_STEP, SUMS, find_stationary
from eqsim.engine.slider_runs import (
    COARSER,
    coarse_instants,
    pulled_columns,
    times_of,
)
from eqsim.engine.slider_runs import COURSE as MEANS
from eqsim.errors import InputError
from eqsim.laws.aging import Unaged
from eqsim.laws.barrier import Mechanical
from eqsim.model.chain import Chain
from eqsim.model.drive import Grid, Output, Programme, Stage
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Pull, drag_of, pull_of
from eqsim.model.slip import width_of
from eqsim.numerics.streams import TRAJECTORY
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool

_EVENT_SPEED = 2.0  # velocity of a block in an event, over the fastest drive
_TOLD_AFTER = 256  # steps between calls of `progress`
_BLOCKS_PER_THREAD = 20  # of `BLOCK` contacts: waking a thread takes as long
_ROOM = 4096  # events, and broken blocks besides those of one step

# A block at an instant of the grid.
RECORD = np.dtype(
    [
        ("X", float),
        ("V", float),
        ("force", float),
        ("pinned", float),
        ("breaks", np.int64),
    ]
)


def pull_of_chain(ensemble: Ensemble, programme: Programme) -> tuple[Chain, Pull]:
    """The chain of a programme, and the pull of a stage on a single block of it. Raises
    InputError for contacts that a chain does not take."""
    chain = programme.chain
    if chain is None:
        raise InputError("elastic.damping: is required, or a mass")
    if ensemble.populations:
        raise InputError("population: a chain takes contacts of one kind")
    if programme.forced or programme.rebinding == "shared":
        raise InputError("drive.force: a chain is pulled by a plate or at its edge")
    chain.contacts_of(ensemble.count)
    stage = Stage(chain.drive_stiffness, chain.damping, chain.mass)
    return chain, pull_of(ensemble, replace(programme, chain=None, stage=stage))


def chained(
    ensemble: Ensemble,
    programme: Programme,
    seed: int,
    replica: int = 0,
    longer: int = 1,
) -> Chained:
    """Make a chain at the start of a programme, with the contacts of a replica. Steps
    are `longer` times as long as its tolerance asks for. Raises InputError."""
    chain, pull = pull_of_chain(ensemble, programme)
    law, unit, pace = ensemble.thresholds, ensemble.thresholds.scale, pull.pace
    B, laws = chain.count, contacts(ensemble, pace)
    ends = np.concatenate(([0], np.cumsum(chain.contacts_of(ensemble.count))))
    coupling = chain.coupling if B > 1 else 0.0
    bulk = chain.bulk_damping * pace / unit if B > 1 else 0.0
    free = coupling == 0.0 and bulk == 0.0
    # A front breaks all contacts of a block within a step, however narrow their law.
    width = width_of(law) if free else law.mean
    barrier, aging = laws.barrier, laws.aging
    speed = programme.velocity_before / pace
    links = Links(
        coupling=float(coupling),
        bulk=bulk,
        damping=pull.damping,
        drag=drag_of(ensemble, pace),
        mass=pull.mass,
        periodic=chain.edges == "periodic",
        free=free,
        springs=chain.springs,
        neighbours=chain.neighbours,
        ends=ends,
        mean_count=ensemble.count / B,
        longest=longer * math.sqrt(chain.tolerance) * width / unit,
        tolerance=longer**2 * chain.tolerance * law.mean / unit,
        waits=not isinstance(barrier, Mechanical) or not isinstance(aging, Unaged),
        fast=_EVENT_SPEED * max(abs(speed), *map(abs, pull.speeds)),
    )
    blocks = Blocks(*np.zeros((len(Blocks._fields), B)))
    blocks.direction.fill(1.0)
    now, then, part = (np.zeros(B, SUMS) for _ in range(3))
    rows = (x.view(float).reshape(B, -1) for x in (then, part))
    population = np.zeros(ensemble.count, CONTACT)
    first, key = replica * ensemble.count, key_of(seed, TRAJECTORY)
    course = np.zeros(1, COURSE)
    lists = np.empty(_ROOM + B, BROKE), np.empty(_ROOM, EVENT)
    c = Chained(
        *(laws, key, first, links, blocks, population),
        *(now, then, part, *rows, course, *lists),
    )
    if speed:
        before = contacts(ensemble, programme.velocity_before)
        find_stationary(before, key, first, population, speed)
    follow_all(c)
    course["dt"] = FIRST_STEP * pull.ends[0]
    if speed:
        weights = np.diff(ends) / links.mean_count
        damping = links.damping + links.drag * (weights - now["pinned"])
        blocks.V.fill(speed)
        blocks.X[:] = _balanced(links, -(now["force"] + damping * speed))
        course["Y"] = -blocks.X[0]
        blocks.X[:] -= blocks.X[0]
    return c


def _balanced(links: Links, force: Array) -> Array:
    """Displacements of springs under a `force` on each block, with Y = 0, (B,)."""
    if links.free:
        return force / links.springs
    balance = balance_of(links.springs, links.coupling, links.periodic)
    return np.asarray(splu(balance).solve(force))


class _Run(NamedTuple):
    """Record of a replica."""

    means: Array  # `MEANS`, (points,)
    records: Array  # `RECORD`, (points, B)
    broke: Array  # `BROKE`
    events: Array  # `EVENT`
    breaks: int
    steps: int


def _mean_over(c: Chained) -> Array:
    """The chain at an instant, the numbers of `MEANS`: means over blocks."""
    links, b, s, sums = c.links, c.blocks, c.course[0], c.now
    weight = np.diff(links.ends) / links.mean_count
    drag = links.drag * (weight - sums["pinned"]) * b.V
    variance = np.maximum(sums["square"] - sums["force"] ** 2 / weight, 0.0)
    apart = np.diff(b.X, append=b.X[:1] if links.periodic else b.X[-1:])
    stored = links.springs * (s["Y"] - b.X) ** 2 + links.coupling * apart**2
    stored = 0.5 * (stored + links.mass * b.V**2) + sums["stored"]
    means = b.X, np.full(b.X.size, s["Y"]), sums["force"] + drag, sums["pinned"]
    energies = np.mean(stored), s["damped"] + s["lost"], s["missed"]
    spread = np.mean(variance) / c.population.size
    behind = np.mean(b.behind)
    return np.array([*map(np.mean, means), spread, s["work"], *energies, behind])


def _record(c: Chained) -> Array:
    """The blocks at an instant, (B,) of `RECORD`."""
    links, b, sums = c.links, c.blocks, c.now
    weight = np.diff(links.ends) / links.mean_count
    row = np.empty(b.X.size, RECORD)
    row["X"] = b.X
    row["V"] = b.V
    row["force"] = sums["force"] + links.drag * (weight - sums["pinned"]) * b.V
    row["pinned"] = sums["pinned"] / weight
    row["breaks"] = np.rint(b.breaks)
    return row


class Sharing(NamedTuple):
    """Threads that share the blocks of a chain: the caller and those of a pool."""

    pool: ThreadPool
    edges: list[int]  # of the shares

    @classmethod
    def of(cls, pool: ThreadPool, c: Chained, threads: int) -> "Sharing":
        """Shares of about as many contacts."""
        ends = c.links.ends
        aims = np.linspace(0, ends[-1], threads + 1)
        return cls(pool, np.searchsorted(ends, aims).tolist())

    def march(
        self, c: Chained, until: float, speed: float, most: int, stop: Array
    ) -> bool:
        """`chain_steps.march`: the same bits."""
        shares = [*pairwise(self.edges)]
        for _ in range(most):
            if c.course["time"][0] >= until or stop[0]:
                break
            dt, off = begin_step(c, until, speed)
            others = [
                self.pool.submit(follow_share, c, dt, *share) for share in shares[1:]
            ]
            follow_share(c, dt, *shares[0])
            for other in others:
                other.result()
            if not end_step(c, dt, until, speed, off):
                return False
        return True


def follow(
    c: Chained,
    pull: Pull,
    instants: Array,
    stop: Array,
    told: Callable[[int, float], None],
    sharing: Sharing | None = None,
    keep: Keep | None = None,
    number: int = 0,
) -> _Run:
    """Follow a chain through its programme. `told` gets the breaks since it was called
    last, and the time; `keep` the state at records, as that of replica `number`."""
    advance = sharing.march if sharing else march
    means = [_mean_over(c)]
    records = [_record(c)]
    s = c.course[0]
    broke: list[Array] = []
    events: list[Array] = []
    breaks = 0.0

    def tell() -> None:
        nonlocal breaks
        before, breaks = breaks, float(c.blocks.breaks.sum())
        told(round(breaks - before), float(s["time"]))

    arrays = {"population": c.population, "now": c.now, "course": c.course}
    rows = {"means": means, "records": records}
    chunks = {"broke": broke, "events": events}
    state = State(c.blocks._asdict() | arrays, rows, chunks)
    if done := state.restore(keep, number):
        del means[0], records[0]  # those of the start, which the state has, too
        tell()
    row = max(1, done)
    for end, speed in zip(pull.ends, pull.speeds, strict=True):
        while row < instants.size and instants[row] <= end:
            until = float(instants[row])
            while s["time"] < until:
                advance(c, until, float(speed), _TOLD_AFTER, stop)
                if stop[0]:
                    raise CancelledError
                tell()
                broke.append(c.broke[: s["rows"]].copy())
                events.append(c.events[: s["events"]].copy())
                s["rows"] = s["events"] = 0
            means.append(_mean_over(c))
            records.append(_record(c))
            row += 1
            state.save(keep, number, row)
    events.append(_under_way(c))
    course = np.array(means).view(MEANS)[:, 0]
    course["stored"] -= course["stored"][0]
    lives = round(breaks) + c.population.size
    lists = np.concatenate(broke), np.concatenate(events)
    return _Run(course, np.array(records), *lists, lives, int(s["steps"]))


def _under_way(c: Chained) -> Array:
    """The event (`EVENT`) that goes on at the end of a record, (1,), or (0,) if none
    does in which a block has broken."""
    s, blocks = c.course[0], c.blocks.broken.sum()
    if not (s["going_on"] and blocks):
        return np.empty(0, EVENT)
    force = np.mean(c.links.springs * (s["Y"] - c.blocks.X))
    found = np.zeros(1, EVENT)
    for name, value in {
        "event": s["event"],
        "t": s["begin"],
        "duration": s["time"] - s["begin"],
        "blocks": blocks,
        "peak": s["peak"] if s["direction"] > 0.0 else s["least"],
        "drop": s["direction"] * (s["force"] - force),
        "energy": s["damped"] + s["lost"] - s["dissipated"],
    }.items():
        found[name] = value
    return found


def _check(
    ensemble: Ensemble, programme: Programme, output: Output
) -> tuple[Chain, Pull]:
    """The chain of a run, which is neither too large nor too long."""
    chain, pull = pull_of_chain(ensemble, programme)
    points = programme.grid(output.points).t.size
    require_records(points, chain.count * output.replicas)
    return chain, pull


def chain_trajectory(
    ensemble: Ensemble,
    programme: Programme,
    output: Output,
    threads: Threads,
    progress: Progress | None,
    keep: Keep | None = None,
    front: Callable[[int], None] | None = None,
) -> ChainTrajectory:
    """Simulate `trajectory.trajectory` of a chain of blocks; `keep` is where its states
    are. `front` is called now and then with the last block that broke."""
    chain, pull = _check(ensemble, programme, output)
    grid, unit = programme.grid(output.points), ensemble.thresholds.scale
    instants = times_of(grid, pull, unit)
    workers = workers_of(threads)
    lives = ensemble.count * output.replicas

    def told(more: int) -> None:
        nonlocal lives
        lives += more
        if progress:
            progress(lives)

    def simulate(task: tuple[int, int]) -> _Run:
        replica, longer = task
        c = chained(ensemble, programme, output.seed, replica, longer)
        march(c, 0.0, 0.0, 0, pool.stop)  # compiled now, which is not the engine's time
        begun.append(time.perf_counter())
        here = instants if longer == 1 else instants[coarse_instants(grid.segment)]

        def tell(breaks: int, _: float) -> None:
            if longer > 1:
                return
            told(breaks)
            if front and (rows := int(c.course["rows"][0])):
                front(int(c.broke["block"][rows - 1]))

        run = c, pull, here, pool.stop, tell
        place = keep, 2 * replica + (longer > 1)
        if sharing < 2:
            return follow(*run, None, *place)
        with ThreadPool(sharing - 1) as helpers:
            shares = Sharing.of(helpers, c, sharing)
            return follow(*run, shares, *place)

    tasks = [(i, longer) for i in range(output.replicas) for longer in (1, COARSER)]
    most = int(ensemble.count / (_BLOCKS_PER_THREAD * BLOCK))
    sharing = min(workers, most, chain.count) if output.replicas < workers else 1
    begun: list[float] = []
    with ThreadPool(max(1, min(workers, len(tasks)))) as pool:
        if sharing > 1:
            runs = [pool.submit(simulate, task).result() for task in tasks]
        else:
            runs = list(pool.map(simulate, tasks))
    fine, coarse = runs[::2], runs[1::2]
    means, again = (np.array([run.means for run in half]) for half in (fine, coarse))
    columns = pulled_columns(ensemble, programme, grid, pull, means, again)
    if chain.mass == 0.0:
        # nothing but missed forces tells the step, and fast relaxation is over before
        # the first record that both runs have
        least = np.where(grid.t > 0.0, chain.tolerance * ensemble.thresholds.mean, 0.0)
        for name in ("X_stderr", "force_stderr"):
            columns[name] = np.hypot(columns[name], least)
    X = np.array([run.records["X"] for run in fine])
    stage = np.array([run.means["stage"] for run in fine])
    springs = chain.springs * (stage[..., None] - X)
    columns["spring"] = np.mean(springs, axis=(0, 2)) * unit
    broke, coarsely = (
        by_replica([_in_units(run.broke, pull, unit) for run in half])
        for half in (fine, coarse)
    )
    return ChainTrajectory(
        **columns,
        lives=sum(run.breaks for run in fine),
        seed=output.seed,
        engine_seconds=time.perf_counter() - begun[0],
        threads=workers,
        steps=tuple(run.steps for run in fine),
        chain=chain,
        blocks=by_replica([_of_blocks(run, grid, pull, unit) for run in fine]),
        broke=broke,
        events=by_replica([_in_units(run.events, pull, unit) for run in fine]),
        coarser_events=by_replica(
            [_in_units(run.events, pull, unit) for run in coarse]
        ),
        fronts=missing_steps(fronts_of(broke, chain), fronts_of(coarsely, chain)),
    )


# Powers of length and time in the columns of lists.
_POWERS = {"t": (0, 1), "duration": (0, 1), "energy": (2, 0)}
_POWERS |= dict.fromkeys(("X", "force", "peak", "drop"), (1, 0)) | {"V": (1, -1)}


def _in_units(rows: Array, pull: Pull, unit: float) -> dict[str, Array]:
    """Columns of a list in the user's units."""
    columns = {}
    for name in rows.dtype.names or ():
        length, time_ = _POWERS.get(name, (0, 0))
        factor = unit**length * (unit / pull.pace) ** time_
        columns[name] = rows[name] * factor if length or time_ else rows[name].copy()
    return columns


def _of_blocks(run: _Run, grid: Grid, pull: Pull, unit: float) -> dict[str, Array]:
    """Records of the blocks of a replica by column, in the user's units."""
    points, blocks = run.records.shape
    where = {
        "t": np.repeat(grid.t, blocks),
        "block": np.tile(np.arange(blocks), points),
    }
    return where | _in_units(run.records.ravel(), pull, unit)
