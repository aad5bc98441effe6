"""Run files: TOML in, checked, turned into an Ensemble and a Drive.

Structure and types are checked here; what a value may be is known to the law it belongs to.
"""

import csv
import functools
import stat
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import pydantic
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.errors import NOT_NEGATIVE, InputError, meant, require_choice, require_number, shown, under
from eqsim.laws.aging import Aging
from eqsim.laws.delay import Delay
from eqsim.laws.thermal import Thermal
from eqsim.laws.threshold import Delta, Gamma, Table, ThresholdLaw


def _whole(value: Any) -> Any:
    """TOML's 1e5 is a float; accept it where a whole number is meant."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


Whole = Annotated[int, BeforeValidator(_whole)]
_DEEPEST = 16  # nesting of a sweep; its deepest form takes 5
_LONGEST = 10_000_000  # characters of a run file


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Contacts(_Section):
    count: Whole = 100_000
    stiffness: float = 1.0
    stiffness_law: str = "sqrt"


class Thresholds(_Section):
    law: Literal["gamma", "delta", "table"] = "gamma"
    n: float | None = None
    x_star: float | None = None
    file: str | None = None


class ThermalSection(_Section):
    kT: float = 0.0
    attempt_frequency: float = 1.0
    barrier: str = "soft"


class AgingSection(_Section):
    rule: str = "none"
    rate: float = 0.0
    x_star_final: float | None = None


class DelaySection(_Section):
    time: float = 0.0
    law: str = "fixed"


class Viscosity(_Section):
    eta: float = 0.0


class DriveSection(_Section):
    velocity: float | None = None
    distance: float | None = None
    start: str = "fresh"


class Output(_Section):
    points: Whole = 2001
    seed: Whole = 1
    replicas: Whole = 1


class RunFile(_Section):
    """A checked run file; the defaults are the contract."""

    title: Annotated[str, Field(max_length=200)] = ""
    disorder: str = "quenched"
    contacts: Contacts = Contacts()
    thresholds: Thresholds = Thresholds()
    thermal: ThermalSection = ThermalSection()
    aging: AgingSection = AgingSection()
    delay: DelaySection = DelaySection()
    viscosity: Viscosity = Viscosity()
    drive: DriveSection = DriveSection()
    output: Output = Output()
    sweep: dict[str, Any] = {}

    def ensemble(self, folder: Path) -> Ensemble:
        """The contacts; the path of a threshold table is relative to `folder`. Raises InputError."""
        with under("thermal"):
            thermal = Thermal(self.thermal.kT, self.thermal.attempt_frequency, self.thermal.barrier)  # type: ignore[arg-type]
        with under("delay"):
            delay = Delay(self.delay.time, self.delay.law)  # type: ignore[arg-type]
        law = self._threshold_law(folder)
        require_choice("disorder", self.disorder, ("quenched", "annealed"))
        given = self.aging.model_fields_set
        if given and "rule" not in given:  # contacts that do not age would be a surprise
            raise InputError(f'aging.rule: is required with {min(given)}; must be "langevin", "flow" or "none"')
        with under("aging"):
            final = self.aging.x_star_final
            aging = Aging(self.aging.rule, self.aging.rate, 1.0 if final is None else final)  # type: ignore[arg-type]
            aging.check(law, self.disorder)
            if final is None and aging.rule != "none":
                raise InputError(f'x_star_final: is required with rule = "{aging.rule}"')
        drag, springs = self.viscosity.eta, self.contacts
        with under("viscosity"):
            require_number("eta", drag, **NOT_NEGATIVE)
        with under("contacts"):
            return Ensemble(
                thresholds=law,
                thermal=thermal,
                delay=delay,
                aging=aging,
                count=springs.count,
                stiffness=springs.stiffness,
                stiffness_law=springs.stiffness_law,  # type: ignore[arg-type]
                disorder=self.disorder,  # type: ignore[arg-type]
                eta=drag,
            )

    def _threshold_law(self, folder: Path) -> ThresholdLaw:
        given = self.thresholds
        allowed = {"gamma": {"n", "x_star"}, "delta": {"x_star"}, "table": {"file"}}[given.law]
        for key in ("n", "x_star", "file"):
            if getattr(given, key) is not None and key not in allowed:
                raise InputError(
                    f'thresholds.{key} = {shown(getattr(given, key))}: not allowed with law = "{given.law}"'
                )
        x_star = 1.0 if given.x_star is None else given.x_star
        if given.law == "table":
            if given.file is None:
                raise InputError('thresholds.file: is required with law = "table"')
            return read_thresholds(folder / given.file)
        with under("thresholds"):
            return Delta(x_star) if given.law == "delta" else Gamma(1.0 if given.n is None else given.n, x_star)

    def driven(self) -> Drive:
        """How the slider moves. Raises InputError."""
        if self.drive.velocity is None:
            raise InputError("drive.velocity: is required")
        with under("drive"):
            return Drive(self.drive.velocity, self.drive.distance, self.drive.start)  # type: ignore[arg-type]


def read(path: Path) -> str:
    """The text of a run file. Raises InputError."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(_LONGEST + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file in UTF-8") from None
    if len(text) > _LONGEST:  # a device may never end
        raise InputError(f"{path}: is longer than {_LONGEST:.0e} characters; a run file is not")
    return text


def load(path: Path, changes: dict[str, Any] | None = None, text: str | None = None) -> RunFile:
    """Read and check a run file, with `changes` ("section.key": value) put in first; `text` is its content if it has
    been read: a pipe can be read once. Raises InputError."""
    text = read(path) if text is None else text
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also numbers and nesting beyond Python's limits
        raise InputError(f"{path}: is not valid TOML: {error}") from None
    for key, value in (changes or {}).items():
        *sections, last = key.split(".")
        axes, axis = data.get("sweep"), key.removeprefix("sweep.")
        if isinstance(axes, dict) and axis != key and axis in axes:
            sections, last = ["sweep"], axis
        place = data
        for name in sections:
            place = place.setdefault(name, {})
            if not isinstance(place, dict):
                raise InputError(f"{key}: {name} is not a section")
        place[last] = value
    return check(data)


@functools.cache
def keys() -> dict[str, type]:
    """Every `section.key` (or top-level key) but `title` and `sweep`, and the type of its values: float, int or str."""

    def kind(annotation: Any) -> type:
        choices = [choice for choice in get_args(annotation) or (annotation,) if choice is not type(None)]
        return choices[0] if isinstance(choices[0], type) else str  # else of a Literal

    known: dict[str, type] = {}
    for name, field in RunFile.model_fields.items():
        section = field.annotation
        if isinstance(section, type) and issubclass(section, BaseModel):
            known |= {f"{name}.{key}": kind(part.annotation) for key, part in section.model_fields.items()}
        elif name not in ("title", "sweep"):
            known[name] = kind(section)
    return known


def parameters(file: RunFile) -> dict[str, Any]:
    """The values of all `keys()`, with the defaults of the threshold law filled in: equal settings, equal dicts."""
    data = file.model_dump()
    found = {key: data[key] if "." not in key else data[key.split(".")[0]][key.split(".")[1]] for key in keys()}
    if file.thresholds.law != "table" and found["thresholds.x_star"] is None:
        found["thresholds.x_star"] = 1.0
    if file.thresholds.law == "gamma" and found["thresholds.n"] is None:
        found["thresholds.n"] = 1.0
    return {key: value + 0.0 if isinstance(value, float) else value for key, value in found.items()}  # no -0.0


def at(file: RunFile, changes: dict[str, Any]) -> RunFile:
    """The run file of one point of its sweep, with `changes` ("section.key": value). Raises InputError."""
    data = file.model_dump(exclude={"sweep"}, exclude_unset=True)
    for key, value in changes.items():
        if key not in keys():
            hint = meant(key, keys()) or "known are " + ", ".join(keys())
            raise InputError(f"{key}: is not a key that can change from point to point; {hint}")
        *section, last = key.split(".")
        (data.setdefault(section[0], {}) if section else data)[last] = value
    return check(data)


def check(data: dict[str, Any]) -> RunFile:
    """A run file from its content. Raises InputError with one line that names the field."""
    _plain("sweep", data.get("sweep"))
    try:
        return RunFile.model_validate(data)
    except pydantic.ValidationError as error:
        raise InputError(_explain(error)) from None


def _plain(field: str, content: Any) -> None:
    """Refuse what is no number or text of a sweep, wherever it is: dates, huge integers, endless nesting."""
    left = [(field, content, 0)]
    while left:
        name, value, depth = left.pop()
        if depth > _DEEPEST:
            raise InputError(f"{name}: is nested too deep")
        if isinstance(value, dict):
            left += [(f"{name}.{key}", part, depth + 1) for key, part in value.items()]
        elif isinstance(value, list):
            left += [(name, part, depth + 1) for part in value]
        elif not isinstance(value, (str, float, int, type(None))) or (isinstance(value, int) and abs(value) > 10**300):
            raise InputError(f"{name} = {shown(value)}: must be numbers or text")


def _explain(error: pydantic.ValidationError) -> str:
    problems = error.errors(include_url=False)
    first = problems[0]
    field = ".".join(str(part) for part in first["loc"])
    value = shown(first["input"])
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    if first["type"] == "extra_forbidden":
        return f"{field}: unknown key; {_nearest([str(part) for part in first['loc']])}{more}"
    if first["type"] in ("model_type", "dict_type"):
        return f"{field} = {value}: must be a section, [{field}]{more}"
    allowed = first["msg"].replace("Input should be", "must be").replace("String should", "must").replace("'", '"')
    return f"{field} = {value}: {allowed}{more}"


def _nearest(location: list[str]) -> str:
    """Which key may have been meant, here or in another section."""
    sections = {name: info.annotation for name, info in RunFile.model_fields.items()}
    known = {
        name: list(kind.model_fields)
        for name, kind in sections.items()
        if isinstance(kind, type) and issubclass(kind, BaseModel)
    }
    here = known.get(location[0], []) if len(location) > 1 else list(sections)
    elsewhere = [f"{name}.{key}" for name, keys in known.items() if keys != here for key in keys]
    last = location[-1]
    same = [key for key in here + elsewhere if key.rpartition(".")[2].lower() == last.lower()]
    return meant(last, same) or meant(last, here) or "known here: " + ", ".join(here)


def read_thresholds(path: Path) -> Table:
    """A CSV file with a column `threshold`, one positive number a row. Raises InputError."""
    try:
        found = path.stat()
        stamp = (found.st_mtime_ns, found.st_size)
        if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):  # a pipe or a device may never end
            raise InputError(f"thresholds.file = {path}: is not a file")
    except InputError:
        raise
    except (OSError, ValueError):  # the reader says why
        stamp = None
    return _read_thresholds(path, stamp)


@functools.lru_cache(maxsize=8)
def _read_thresholds(path: Path, stamp: tuple[int, int] | None) -> Table:
    """Remembered for as long as the file stays as it is: all points of a sweep share it."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.DictReader(file, skipinitialspace=True, strict=True)
            names = [name.strip() for name in rows.fieldnames or []]
            if "threshold" not in names:
                found = ", ".join(names)[:60] or "nothing"
                raise InputError(
                    f'thresholds.file = {path}: needs a column "threshold" in its first line; found {found}'
                )
            if names.count("threshold") > 1:
                raise InputError(f'thresholds.file = {path}: has {names.count("threshold")} columns "threshold"')
            rows.fieldnames = names
            values = []
            for row in rows:
                text = row["threshold"] or ""
                try:
                    value = float(text if "_" not in text else "nan")  # Python's 1_000 is not a number elsewhere
                except ValueError:
                    value = float("nan")
                if not 0 < value < float("inf"):
                    raise InputError(
                        f"thresholds.file = {path}, line {rows.line_num}: {text[:40]!r} must be a finite number > 0"
                    )
                if any(rest.strip() for rest in row.get(None, [])):
                    raise InputError(
                        f"thresholds.file = {path}, line {rows.line_num}: more values than columns (a decimal comma?)"
                    )
                values.append(value)
    except OSError as error:
        raise InputError(f"thresholds.file = {path}: cannot be read ({error.strerror})") from None
    except InputError:
        raise
    except (ValueError, csv.Error):  # not UTF-8, or not a path
        raise InputError(f"thresholds.file = {str(path)!r}: is not a CSV text file") from None
    if not values:
        raise InputError(f"thresholds.file = {path}: is empty; at least one threshold is needed")
    try:
        return Table(values)
    except InputError as error:
        raise InputError(f"thresholds.file = {path}: {error}") from None
