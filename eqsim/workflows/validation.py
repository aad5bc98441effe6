"""Results of `eqsim validate`."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from eqsim import validation
from eqsim.io import storage
from eqsim.lazy import lazily
from eqsim.validation import Validation
from eqsim.workflows.report import FileResult

with lazily():
    from eqsim.plots import checks


@dataclass(frozen=True)
class ValidationResult(FileResult):
    """Comparison of simulated contacts with the master equation, without a run file."""

    found: Validation
    command = "validate"

    def title(self, name: str) -> str:
        count, least = len(self.found.scores), validation.ALARM
        return f"suite {name}: {count} comparisons, each p must exceed {least:g}"

    def origin(self) -> dict[str, Any]:
        suite = {"suite": self.found.suite}
        return storage.provenance("validate", suite, "", self.found.seed)

    def summary(self) -> dict[str, Any]:
        found = self.found
        messages = [one for one in found.unscored if one.message]
        laws = (validation.law_text(one.ensemble.thresholds) for one in messages)
        refused = zip(laws, (one.message for one in messages), strict=True)
        return {
            **{"suite": found.suite, "seed": found.seed, "passed": found.passed},
            "verdicts": [asdict(verdict) for verdict in found.verdicts],
            "declined": found.declined,
            "left_out": validation.left_out(found.unscored),
            **{"refused": sorted(set(refused)), "versions": storage.versions()},
        }

    def tables(self) -> dict[str, Any]:
        return {"scores": validation.columns(self.found.scores)}

    def figures(self, title: str) -> dict[str, Any]:
        return {"validation": checks.validation_figure(self.found)}

    def rows(self) -> Iterator[tuple[Any, ...]]:
        tested = "scores", "chi-square", "p", "largest |z|", "p (of so many)"
        yield "kind", *tested, "verdict"
        for v in self.found.verdicts:
            passed = v.passed and v.kind not in self.found.declined
            yield (
                *(v.kind, v.count, f"{v.chi_square:.1f}/{v.even}"),
                *(f"{v.p_chi_square:.2g}", f"{v.largest:.2f}", f"{v.p_largest:.2g}"),
                "passed" if passed else "FAILED",
            )

    def notes(self) -> Iterator[str]:
        reasons = Counter(one.reason for one in self.found.unscored)
        counts = (f"{reasons[reason]} {reason}" for reason in validation.REASONS)
        yield "left out: " + ", ".join(counts)
