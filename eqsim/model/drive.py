"""How the slider is driven, and how a run is recorded."""

from dataclasses import dataclass
from typing import Literal

from eqsim.errors import POSITIVE, InputError, require_choice, require_integer, require_number, shown
from eqsim.model.ensemble import Ensemble

Start = Literal["fresh", "stationary"]


@dataclass(frozen=True)
class Drive:
    """Rigid slider at constant velocity.

    Parameters
    ----------
    velocity : float
        v (length/time), > 0.
    distance : float, optional
        How far (length); by default 200 mean newborn thresholds.
    start : str
        "fresh": all contacts pinned and unstretched at X = 0. "stationary": the steady state.

    Raises
    ------
    InputError
        For a value out of range.
    """

    velocity: float
    distance: float | None = None
    start: Start = "fresh"

    def __post_init__(self) -> None:
        require_number("velocity", self.velocity, **POSITIVE)
        if self.distance is not None:
            require_number("distance", self.distance, **POSITIVE)
        require_choice("start", self.start, ("fresh", "stationary"))

    def over(self, ensemble: Ensemble) -> float:
        """The distance, with its default filled in."""
        return 200.0 * ensemble.thresholds.mean if self.distance is None else self.distance


def require_drive(drive: Drive) -> None:
    """Raise InputError for what is not a drive, such as a bare velocity."""
    if not isinstance(drive, Drive):
        raise InputError(f"drive = {shown(drive)}: must be a Drive, for example Drive(velocity=0.1)")


def check_output(points: int, seed: int, replicas: int) -> None:
    """Raise InputError unless the size and seed of a recording can be used."""
    require_integer("points", points, 2, 2 * 10**7)
    require_integer("seed", seed, 0, 2**63 - 1)
    require_integer("replicas", replicas, 1, 10**9)
