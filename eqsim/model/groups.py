"""The dimensionless groups of a run for `eqsim info`, and warnings of those so extreme
that units were probably mixed."""

import math
from collections.abc import Iterator
from typing import NamedTuple

from eqsim.laws.barrier import BARRIERS
from eqsim.laws.barrier.pooled import MOST_POOLED_STEPS, has_thin_tail
from eqsim.laws.threshold import Gamma
from eqsim.model.chain import Chain
from eqsim.model.drive import Drive, Programme, over_distance
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import delay_of, drag_of, legs, pull_of
from eqsim.paper import equation

# b below which, and above which, units were probably mixed: 1e9 is that of a metal
# asperity at room temperature.
_LEAST_B = 1e-15
_LARGEST_B = 1e11
# Distance over threshold below which they probably were.
_DOUBTFUL_DISTANCE = 1e-4


class Group(NamedTuple):
    """A dimensionless group, or a scale, of a run: its name, value and meaning."""

    name: str
    value: float | str
    meaning: str


def groups(ensemble: Ensemble, drive: Drive | Programme) -> list[Group]:
    """List what decides the regime of a run; along a programme velocity is that of the
    fastest segment. Several kinds of contacts are numbered. Raises InputError."""
    if ensemble.populations:
        way, found = over_distance(drive, ensemble), list[Group]()
        for kind in ensemble.kinds:
            each = [Group("N", kind.contacts.count, "contacts of this population")]
            each += groups(kind.contacts, way)
            found += [one._replace(name=f"{kind.number}: {one.name}") for one in each]
        return found
    if isinstance(drive, Drive):
        rows = [*_of_contacts(ensemble, drive.velocity)]
        distance = drive.over(ensemble) / ensemble.thresholds.scale
        rows.append(("distance/x_*", distance, "how far the run slides"))
        if drive.elastic:
            rows += _of_blocks(ensemble.count, drive.elastic)
    else:
        v = max(leg.pace for leg in legs(ensemble, drive))
        rows = [*_of_contacts(ensemble, v), *_of_programme(ensemble, drive, v)]
    return [Group(*row) for row in (*rows, *_of_tails(ensemble))]


Rows = Iterator[tuple[str, float | str, str]]


def _of_contacts(ensemble: Ensemble, v: float) -> Rows:
    law, thermal, b = ensemble.thresholds, ensemble.thermal, ensemble.b
    unit, aging, born = law.scale, ensemble.aging, ensemble.newborn
    annealed = ensemble.disorder == "annealed"
    two = "quenched: literal contacts; annealed: the published master equation"
    yield "disorder", ensemble.disorder, two
    yield "x_star", unit, "unit of length: x_* or unit of the law, else its mean"
    barrier = BARRIERS[thermal.barrier]
    rate = barrier.numbers(thermal, ensemble.stiffness, unit)[1]
    name, said = "v/(omega x_*)", "velocity in x_* per attempt"
    if barrier.by_force:
        yield "b", b, f"{barrier.b_words}, force at x_* of a {thermal.barrier} bond"
        name, said = "v/(k_0 x_*)", "velocity in x_* per mean life at zero force"
    else:
        cited = equation("nt08a")
        yield "b", b, f"k x_*^2 / (2 kT), barrier over temperature ({cited})"
        cold = f"temperature over its crossover ({equation('nt09a')})"
        yield "T/T_*", 0.0 if math.isinf(b) else 1.0 / b, cold
    if rate > 0:
        yield name, v / (rate * unit), said
    pooled = law.steps.size <= MOST_POOLED_STEPS
    if barrier.by_force and ensemble.stiffness_law == "sqrt":
        pooled = pooled and has_thin_tail(law)  # or off-rates have no mean
    star = ensemble.crossover_velocity if pooled else 0.0
    if 0 < star < math.inf:
        where = "" if annealed else ", not of these quenched contacts"
        said = f"crossover velocity of the annealed ensemble{where}"
        yield "v_*", star, f"{said}, Delta U(inf) = 1 ({equation('nt12')}; derived)"
        below = "below 1, thermal breaking decides (annealed ensemble only)"
        yield "v/v_*", v / star, below
    if aging.active and aging.cutoff_time is not None:
        growth = "growth of thresholds per e-fold of their age"
        yield "beta", aging.beta or 0.0, growth
        slid = v / unit * aging.cutoff_time
        yield "v t_c/x_*", slid, "distance slid before thresholds grow"
    elif aging.active:
        final = aging.final(unit)
        yield "x_*f/x_*i", final, "final over newborn threshold scale"
        yield "D/(v x_*f)", aging.rate / (v * final * unit), "aging over sliding"
    if born.active:
        births = born.reduced(unit)
        low, high = births.range
        per = "xi" if born.of == "threshold" else "x_*"
        tail = "of newborn contacts (1e-16 of {} law is {})"
        yield f"<y>/{per}", births.mean, "mean stretch of newborn contacts"
        yield f"least y/{per}", low, tail.format("a normal", "below")
        yield f"greatest y/{per}", high, tail.format("an unbounded", "above")
    if ensemble.delay.time > 0:
        slid = delay_of(ensemble, v).mean
        yield "v tau/x_*", slid, "distance slid while detached"
    if drag_of(ensemble, v) > 0:
        yield "eta v/(k x_*)", drag_of(ensemble, v), "viscous force, detached"


def _of_programme(ensemble: Ensemble, programme: Programme, v: float) -> Rows:
    path = sum(segment.path for segment in programme.segments)
    yield "segments", len(programme.segments), "of the programme"
    said = "how far the run slides, there and back"
    yield "path/x_*", path / ensemble.thresholds.scale, said
    paces = (leg.pace for leg in legs(ensemble, programme) if leg.sign)
    slowest = min(paces, default=v)
    yield "slowest/fastest", slowest / v, "velocities of the segments that move"
    if programme.chain:
        yield from _of_blocks(ensemble.count, programme.chain)
        yield from _of_chain(programme.chain, v / ensemble.thresholds.scale)
        return
    if programme.elastic:
        yield from _of_blocks(ensemble.count, programme.elastic)
    if programme.elastic or not programme.pulled:
        return
    pull = pull_of(ensemble, programme)
    if programme.forced:
        most = float(max(map(abs, pull.knots[1])))
        yield "f/x_*", most, "largest force on the slider, over N k"
    if programme.motor:
        yield "s/x_*", pull.stall, "stall force of the motor, over N k"
    if programme.stage:
        spring = "spring of the stage over that of all contacts, K/(N k)"
        yield "kappa_s", pull.stiffness, spring
        yield "eta_s v/x_*", pull.damping, "damping of the slider at that velocity"
        yield "m v^2/x_*^2", pull.mass, "inertia of the slider at that velocity"


def _of_tails(ensemble: Ensemble) -> Rows:
    """The answer to whether rare strong contacts dominate averages over time."""
    law, aging = ensemble.thresholds, ensemble.aging
    quenched = ensemble.disorder == "quenched"
    if not (ensemble.thermal.active and quenched) or law.steps.size:
        return
    if (greatest := law.support[1]) < math.inf:
        yield "heavy tails", "no", f"no threshold exceeds {greatest:g}"
    elif aging.active and aging.cutoff_time is not None:
        why = "at every kT: thresholds that grow as ln t outlive all attempts"
        yield "heavy tails", "yes", why
    elif BARRIERS[ensemble.thermal.barrier].by_force:
        yield "heavy tails", "no", "no: rates do not fall with the threshold"
    elif not isinstance(law, Gamma) or aging.active:
        return  # what decides is not b
    elif ensemble.stiffness_law == "sqrt":
        why = "k_i grows with the threshold, so barriers outgrow their rarity"
        yield "heavy tails", "yes", f"at every kT: {why}"
    elif ensemble.b >= 0.5:
        yield "heavy tails", "yes", "b >= 1/2: rare strong contacts dominate time"
    else:
        yield "heavy tails", "no", "no: b < 1/2, linear creep at low v"


def _of_blocks(contacts: int, elastic: Elastic) -> Rows:
    """Groups of coupled blocks. Raises InputError if contacts cannot be divided."""
    nx, ny = elastic.shape
    kind, shape = ("chain", f"{nx}") if ny == 1 else ("sheet", f"{nx} x {ny}")
    yield "blocks", shape, f"{kind} with {elastic.edges} edges"
    numbers = elastic.contacts_of(contacts)
    if elastic.load is None:
        yield "n", int(numbers[0]), "contacts of a block, N over blocks"
    else:
        between = f"{numbers.min()} to {numbers.max()}"
        yield "n_j", between, "contacts of a block, in proportion to its load"
    coupling = "spring between neighbours over the contacts of a block"
    yield "kappa_b/(n k)", elastic.coupling, coupling
    pulled = "spring of a block to the plate, over the same"
    if elastic.drive == "edge":
        pulled = "spring that pulls the first block, over the same"
    yield "K_d/(n k)", elastic.drive_stiffness, pulled
    if elastic.edge_stiffness is not None:
        edge = "another spring that pulls the first block, over the same"
        yield "K_e/(n k)", elastic.edge_stiffness, edge
    reach = "blocks over which the displacement by a break decays"
    yield "lambda", elastic.length, reach
    if elastic.differ:
        return
    rho = "n k/(n k + K_d), breaks that follow from one directly"
    yield "rho", elastic.branching, rho
    yield "mean size", elastic.mean_size, "1 + n k/K_d, breaks of an avalanche"
    cutoff = 1.0 / (1.0 - elastic.branching) ** 2
    yield "cutoff size", cutoff, "up to which P(s) ~ s^(-3/2)"


def _of_chain(chain: Chain, rate: float) -> Rows:
    """Groups of a chain in time; `rate` is the velocity over the threshold scale."""
    if chain.mass:
        c = chain.wave_speed
        yield "c", c, "sqrt(K/M), speed of waves without contacts, blocks per time"
    yield "M v^2/x_*^2", chain.mass * rate**2, "inertia of a block at that velocity"
    yield "eta v/x_*", chain.damping * rate, "damping of a block at that velocity"
    bulk = "damping between neighbours at that velocity"
    yield "alpha v/x_*", chain.bulk_damping * rate, bulk


def doubts(ensemble: Ensemble, drive: Drive | Programme | None) -> Iterator[str]:
    """Warn about dimensionless groups so extreme that units were probably mixed, a line
    for each. Without a drive the distance does not count."""
    if ensemble.populations:
        for kind in ensemble.kinds:
            yield from doubts(kind.contacts, drive)
        return
    b, unit = ensemble.b, ensemble.thresholds.scale
    are = f"are all numbers in the same units? Thresholds are about {unit:.3g}"
    if ensemble.thresholds.steps.size:
        are += "; thresholds.scale = 1e-9 turns those of a table from nm into m"
    words = BARRIERS[ensemble.thermal.barrier].b_words
    if ensemble.thermal.active and not _LEAST_B <= b <= _LARGEST_B and b:
        idle = ", so that heat changes nothing" if b > _LARGEST_B else ""
        yield f"b = {words} = {b:.3g}, energy of a contact over heat{idle}: {are}"
    if isinstance(drive, Drive):
        distance = drive.over(ensemble) / unit
        if distance < _DOUBTFUL_DISTANCE:
            hardly = "of a threshold, so that hardly any contact breaks"
            yield f"drive.distance is {distance:.3g} {hardly}: {are}"
