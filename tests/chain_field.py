"""Mean field of a chain of blocks: the limit of infinitely many contacts in each
(derived).

Each block is a mean field of its own, cohorts of contacts that follow X_j (`cohorts`);
springs couple them:

    M X_j'' + eta X_j' = K_j (Y - X_j) - (K + alpha d/dt)(L X)_j - F_j[X_j(.)],

all per n k. In a step F_j changes by about A_j dX_j + r_j dt, A_j being the stiffness
of its pinned contacts. X is found by the trapezoidal rule, which is of second order, and
r_j, the change by breaks and births, by iteration until the forces agree.
"""

from typing import NamedTuple

import numpy as np

from eqsim.errors import InputError, require_number
from eqsim.master.cohorts import History, advanced, begun
from eqsim.master.slider import task_of
from eqsim.model.drive import Programme
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import kernel
from eqsim.numerics.tables import Array

begin_block, advanced_block = kernel(begun), kernel(advanced)

# Error of F in a step, in typical thresholds, at which r has been found.
_AGREED = 1e-7
# Most trials of a step.
_TRIALS = 20


class ChainField(NamedTuple):
    """Means of blocks in the user's units: t, (instants,); displacement of each block
    and force F_j/(n k) of its contacts (lengths), and the pinned share, (instants,
    blocks)."""

    t: Array
    X: Array
    force: Array
    pinned: Array


class Links(NamedTuple):
    """Springs of blocks over n k: that of each block to the plate, (blocks,), K, alpha
    (time), and whether the chain is a ring."""

    plate: Array
    coupling: float
    bulk_damping: float = 0.0
    ring: bool = False

    def laplacian(self) -> Array:
        """L, the sum over neighbours of X_j - X_i, shape (blocks, blocks)."""
        blocks = self.plate.size
        L = np.zeros((blocks, blocks))
        for j in range(blocks if self.ring else blocks - 1):
            pair = [j, (j + 1) % blocks]
            L[np.ix_(pair, pair)] += [[1.0, -1.0], [-1.0, 1.0]]
        return L


def chain_field(
    ensemble: Ensemble,
    programme: Programme,
    links: Links,
    steps: int,
    *,
    offset: Array | None = None,
    fine: float = 2.0,
) -> ChainField:
    """Solve for the motion of blocks of infinitely many contacts behind springs.

    The stage of `programme` moves at one constant velocity and gives the mass and the
    damping of a block over n k; `links` has the springs. Contacts start as they do
    behind a stage; `offset` (lengths, (blocks,)) displaces blocks without stretching
    contacts. It takes `steps` equal steps, whose error falls as their square, and
    cohorts `fine` times as fine as the coarsest. Raises InputError as `eqsim.transient`
    does, for several segments, and where steps are too long to converge."""
    if len(programme.segments) != 1 or programme.stage is None:
        raise InputError("drive.programme: a chain takes a stage and one segment")
    if ensemble.populations:
        raise InputError("population: a chain takes contacts of one kind")
    task = task_of(ensemble, programme, programme.grid(2))
    spring, numerics = task.spring, task.parts[0].numerics
    require_number("viscosity", spring.drag, least=0.0, most=0.0)
    unit, time = ensemble.thresholds.scale, float(programme.grid(2).t[-1])
    contacts, t = numerics.contacts(fine), np.linspace(0.0, 1.0, steps + 1)
    blocks, L = links.plate.size, links.laplacian()
    X, means = np.zeros((blocks, t.size)), np.zeros((blocks, 4, t.size))
    histories = [History(*row) for row in means]
    paths = [numerics.path(t, row, fine) for row in X]
    state = [
        begin_block(contacts, *each) for each in zip(paths, histories, strict=True)
    ]
    springs = np.diag(links.plate) + links.coupling * L
    viscous = spring.damping * np.eye(blocks) + links.bulk_damping / time * L
    dt, speed = 1.0 / steps, float(numerics.course.velocity[0])
    moved = np.zeros(blocks) if offset is None else np.asarray(offset, float) / unit
    V = np.full(blocks, spring.velocity)
    # the plate is where the springs balance all blocks together, as behind a stage
    pull = np.zeros(blocks)
    if spring.in_balance:
        pull = means[:, 0, 0] + spring.damping * V
    net = pull - means[:, 0, 0] - springs @ moved
    r = np.zeros(blocks)
    for m in range(1, t.size):
        A = np.array([block.stiffness for block in state])
        matrix = viscous + 0.5 * dt * (springs + np.diag(A))
        matrix += 2.0 * spring.mass / dt * np.eye(blocks)
        known = 2.0 * spring.mass * V + dt * net + 0.5 * dt**2 * speed * links.plate
        inverse, force = np.linalg.inv(matrix), means[:, 0, m - 1]
        for _ in range(_TRIALS):
            dX = inverse @ (known - 0.5 * dt**2 * r)
            X[:, m] = X[:, m - 1] + dX
            after = [
                advanced_block(contacts, path, block, history, m)
                for path, block, history in zip(paths, state, histories, strict=True)
            ]
            missed = (means[:, 0, m] - force - A * dX) / dt - r
            r = r + missed
            if float(np.abs(missed).max()) * dt < _AGREED * numerics.typical:
                break
        else:
            raise InputError(f"steps = {steps}: are too few, the chain snaps")
        state = after
        net += speed * dt * links.plate - springs @ dX - (means[:, 0, m] - force)
        V = 2.0 * dX / dt - V if spring.mass else dX / dt
    place = unit * (X + moved[:, None]).T
    return ChainField(time * t, place, unit * means[:, 0].T, means[:, 1].T)
