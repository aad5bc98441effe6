"""The surface and the machine that a run file with units stands for."""

from collections.abc import Iterator

from eqsim import catalogue
from eqsim.io.runfile import RunFile
from eqsim.io.units import number_and_unit
from eqsim.laws.barrier import BARRIERS
from eqsim.model.ensemble import Ensemble

_IDLE_B = 1e10  # k x_*^2/(2 kT) above which heat changes friction by less than 1e-8
_LARGEST_MU = 5.0  # friction coefficient above which units were probably mixed


def machine_stiffness(file: RunFile, stiffness: float) -> str:
    """The stiffness K of a machine of this kappa_s = K/(N k), in the unit of that of
    the stage, or of the force on all contacts; "" if neither is known."""
    stage = file["drive.stage"] or {}
    if text := stage.get("machine_stiffness"):
        number, unit = number_and_unit(text)
        assert number is not None
        return f"{number * stiffness / stage['stiffness']:.5g}{unit}"
    unit = file.units.label(catalogue.dimension("force/length"))
    forces = (one for one in file.quantities if one.name == "force")
    return next((f"{one.factor * stiffness:.5g} {unit}" for one in forces), "")


def doubts(file: RunFile) -> Iterator[str]:
    """Say what was assumed for a surface whose units or interface are given, and
    warn of heat that is idle and a friction coefficient that is too large. Contacts are
    stretched to about half the mean of their thresholds."""
    if not file.units and not file.interface:
        return
    ensemble, assumed = file.ensemble, ["contacts.count"]
    several = bool(ensemble.populations)
    if not several:
        assumed.append("contacts.stiffness")
        if _attempts(ensemble):
            assumed.append("thermal.attempt_frequency")
    said = []
    for key in assumed:
        section, name = key.split(".")
        unit = file.units.label(catalogue.KEYS[key].dimension)
        if name not in file.given.get(section, {}):
            said.append(f"{key} = {file[key]:,g} {unit}".replace(",", " ").strip())
    if said:
        yield f"not given, and assumed: {', '.join(said)}"
    for kind in ensemble.kinds:
        b, of = kind.contacts.b, f"population.{kind.number}: " * several
        if _attempts(kind.contacts) and b > _IDLE_B:
            yield f"{of}b = {b:.3g}: heat does next to nothing, friction is that of T = 0"
    mean = sum(x.weight * x.contacts.thresholds.mean for x in ensemble.kinds)
    for one in file.quantities:
        mu = one.factor * 0.5 * mean
        if one.symbol == "mu" and mu > _LARGEST_MU:
            units = "are stiffness, thresholds, count and load in the same units?"
            yield f"friction coefficients are about {mu:.3g}: {units}"


def _attempts(contacts: Ensemble) -> bool:
    """True if heat breaks contacts of one kind over a barrier that it attempts."""
    return contacts.thermal.active and not BARRIERS[contacts.thermal.barrier].by_force
