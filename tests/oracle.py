"""A slow, obvious simulation of frictional contacts: the script a researcher writes
first.

Every contact is an entry of an array, the slider moves by `step` at a time, and
whatever can happen to a contact is decided once per step with its probability. Nothing
here is shared with eqsim. Events are noticed at the end of a step, so that the averages
have errors of first order in the step.

Model (section numbers of Braun and Peyrard, Phys. Rev. E 83, 046129): thresholds xi
with xi^2/x_*^2 ~ Gamma(n+1) (II); k_i = k xi/xi_rms (sqrt law) or k; barriers `soft`
and `stiff` (IV); delay and viscosity of detached contacts (V). Thresholds of pinned
contacts age from x_* to x_*f at the rate D: under `langevin` xi is the length of a
vector of 2n+2 components (n a half-integer), each of which relaxes at the rate
2D/x_*f^2 to the variance x_*f^2/2; under `flow` it grows as the scale of that law.
Under `logarithmic` it grows as 1 + beta ln(1 + t/t_c), and the stiffness stays that of
the newborn contact. Contacts may be born stretched, along the motion or against it.
Annealed contacts are born with thresholds aged for an Exp(1) multiple of the mean
pinned time, and keep them.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class Contacts:
    """What the contacts are like and how fast they are driven; the names are those of a
    run file."""

    n: float = 1.0
    x_star: float = 1.0
    stiffness: float = 1.0
    stiffness_law: str = "sqrt"  # or "uniform"
    kT: float = 0.0
    attempt_frequency: float = 1.0
    barrier: str = "soft"  # or "stiff"
    disorder: str = "quenched"  # or "annealed"
    delay: float = 0.0
    delay_law: str = "fixed"  # or "exponential"
    eta: float = 0.0
    velocity: float = 1.0
    aging: str = "none"  # or "langevin", "flow", "logarithmic"
    rate: float = 0.0  # D
    x_star_final: float = 1.0
    beta: float = 0.0
    cutoff_time: float = 1.0  # t_c
    pinned_time: float = 0.0  # mean, of annealed contacts that age: see `settled`
    factors: tuple = ()  # of the velocity in the intervals between two looks: 0 is a hold, a negative one a reversal
    frozen: bool = False  # a deliberate mistake: thresholds stay what they are in holds
    births: tuple = ()  # stretches at birth are uniform from the first to the second number
    fraction: bool = False  # these are fractions of the contact's threshold
    # a deliberate mistake: newborn thresholds do not know that they hold
    careless: bool = False

    def thresholds(self, rng, size):
        scale = self.x_star
        if self.disorder == "annealed" and self.aging != "none":
            scale = self.scale(rng.exponential(self.pinned_time, size))
        return scale * np.sqrt(rng.gamma(self.n + 1.0, size=size))

    def newborn(self, rng, size):
        """Thresholds and stretches. A contact that forms is one that holds: others are
        drawn again."""
        xi = self.thresholds(rng, size)
        if not self.births:
            return xi, np.zeros(size)
        y = rng.uniform(*self.births, size)
        if self.fraction:
            return xi, y * xi
        bound = np.abs(y) if self.disorder == "quenched" else y
        while not self.careless and np.any(weak := xi <= bound):
            xi[weak] = self.thresholds(rng, weak.sum())
        return xi, y

    def scale(self, age):
        """x_*(age) of unbroken thresholds."""
        final2 = self.x_star_final**2
        return np.sqrt(
            final2 + (self.x_star**2 - final2) * np.exp(-4 * self.rate * age / final2)
        )

    def aged(self, rng, xi, age, dt):
        """Thresholds xi of age `age` after one more time step."""
        if self.aging == "flow":
            return xi * self.scale(age + dt) / self.scale(age)
        if self.aging == "logarithmic":
            return xi * self.grown(age + dt) / self.grown(age)
        keep = np.exp(-2 * self.rate * dt / self.x_star_final**2)
        vector = np.zeros((round(2 * self.n + 2), xi.size))
        vector[0] = xi * keep
        vector += rng.normal(
            scale=self.x_star_final * np.sqrt((1 - keep**2) / 2), size=vector.shape
        )
        return np.sqrt((vector**2).sum(axis=0))

    def grown(self, age):
        """By what factor thresholds of that age have grown that grow as a logarithm,
        and their stiffness does not."""
        return (
            1 + self.beta * np.log(1 + age / self.cutoff_time)
            if self.aging == "logarithmic"
            else 1.0
        )

    def crossed(self, rng, gap, gap_after, dt):
        """Whether a fluctuating gap between threshold and stretch was closed within a
        step: a Brownian bridge."""
        return rng.random(gap.size) < np.exp(
            -gap * np.maximum(gap_after, 0.0) / (self.rate * dt)
        )

    def k(self, xi, age):
        """Stiffness of contacts of thresholds xi and that age."""
        if self.stiffness_law == "uniform":
            return np.full_like(xi, self.stiffness)
        return (
            self.stiffness
            * xi
            / self.grown(age)
            / (self.x_star * np.sqrt(self.n + 1.0))
        )

    def attempt_breaks(self, x, xi):
        """Probability that one thermal attempt breaks contacts of stretch x and
        threshold xi; 0 if xi <= x."""
        gap = np.maximum(1.0 - x / xi, 0.0)
        if self.barrier == "soft":
            chance = np.exp(
                -self.k(xi, x / self.velocity)
                * np.maximum(xi**2 - x**2, 0.0)
                / (2 * self.kT)
            )
        else:
            chance = np.sqrt(gap) * np.exp(
                -self.k(xi, x / self.velocity) * xi**2 * gap**1.5 / (2 * self.kT)
            )
        return np.where(xi > x, chance, 0.0)


class Record(NamedTuple):
    """F/(N k) and pinned fraction with their standard errors, arrays over the recorded
    displacements."""

    force: np.ndarray
    force_stderr: np.ndarray
    pinned: np.ndarray
    pinned_stderr: np.ndarray


def simulate(
    contacts: Contacts,
    count: int,
    step: float,
    record_every: int,
    records: int,
    seed: int,
) -> Record:
    """Slide from a fresh start (all contacts pinned, unstretched) and look at the force
    every `record_every` steps of time, in which the slider moves by `step` times the
    factor of the interval."""
    c, rng = contacts, np.random.default_rng(seed)
    dt = step / c.velocity
    age, wait, pinned = np.zeros(count), np.zeros(count), np.ones(count, bool)
    xi, x = c.newborn(rng, count)
    rows = []
    for i in range(1, record_every * records + 1):
        factor = c.factors[(i - 1) // record_every] if c.factors else 1.0
        gap = xi - np.abs(x)
        ages = (
            c.aging != "none"
            and c.disorder == "quenched"
            and not (c.frozen and factor == 0)
        )
        if ages:
            xi = np.where(pinned, c.aged(rng, xi, age, dt), xi)
        x[pinned] += factor * step
        age[pinned] += dt
        breaks = pinned & (
            (x if c.births and c.disorder == "annealed" else np.abs(x)) >= xi
        )
        if c.aging == "langevin" and ages:
            breaks |= pinned & c.crossed(rng, gap, xi - np.abs(x), dt)
        if c.kT > 0 and c.disorder == "quenched":
            rate = c.attempt_frequency * c.attempt_breaks(np.abs(x), xi)
            breaks |= pinned & (rng.random(count) < -np.expm1(-rate * dt))
        elif c.kT > 0:
            attempts = rng.poisson(c.attempt_frequency * dt, count) * pinned
            who = np.repeat(np.arange(count), attempts)
            success = rng.random(who.size) < c.attempt_breaks(
                np.abs(x[who]), c.thresholds(rng, who.size)
            )
            breaks[who[success]] = True

        wait[~pinned] -= dt
        pins = ~pinned & (wait < 1e-6 * dt)
        if c.delay > 0:
            wait[breaks] = (
                c.delay
                if c.delay_law == "fixed"
                else rng.exponential(c.delay, breaks.sum())
            )
            pinned[breaks] = False
        else:
            pins |= breaks
        pinned[pins], age[pins] = True, 0.0
        xi[pins], x[pins] = c.newborn(rng, pins.sum())

        if i % record_every == 0:
            force = (
                np.where(pinned, c.k(xi, age) * x, c.eta * c.velocity * factor)
                / c.stiffness
            )
            rows.append(
                (
                    force.mean(),
                    force.std() / count**0.5,
                    pinned.mean(),
                    pinned.std() / count**0.5,
                )
            )
    return Record(*np.array(rows).T)


def settled(contacts: Contacts, count: int, step: float, seed: int) -> Contacts:
    """Annealed contacts that age, with the mean pinned time that they themselves have:
    lives are simulated with a guess of it, again and again."""
    for i in range(12):
        rng = np.random.default_rng((seed, i))
        xi, alive, total = contacts.thresholds(rng, count), np.ones(count, bool), 0.0
        x = 0.0
        while alive.any():
            x += step
            total += step * alive.sum()
            alive &= x < xi
            if contacts.kT > 0:
                attempts = (
                    rng.poisson(
                        contacts.attempt_frequency * step / contacts.velocity, count
                    )
                    * alive
                )
                who = np.repeat(np.arange(count), attempts)
                success = rng.random(who.size) < contacts.attempt_breaks(
                    x, contacts.thresholds(rng, who.size)
                )
                alive[who[success]] = False
        contacts = replace(
            contacts, pinned_time=(total / count - step / 2) / contacts.velocity
        )
    return contacts
