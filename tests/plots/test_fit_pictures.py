"""Pictures of fits: titles that fit on the page, and units that exist."""

from types import SimpleNamespace

import numpy as np
import pytest

from eqsim import Programme, RateAndState, Segment, fit_rate_and_state, record_of
from eqsim.fitting.fit import prepare
from eqsim.fitting.pictures import (
    compared_figure,
    data_figure,
    identifiability_figure,
    posterior_figure,
    profiles_figure,
)
from eqsim.io.runfile import check
from eqsim.io.units import Units
from eqsim.plots.style import saved

LONG = "a fit of one key " * 5 + "to many data"


def one_key():
    """A fit of kT alone and its posterior, as far as pictures see them."""
    key = "thermal.kT"
    side = SimpleNamespace(
        points=np.array([[0.0], [2.0]]), rise=np.array([0.0, 4.0]), ends={"95": 2.0}
    )
    parameter = SimpleNamespace(
        key=key, value=np.exp, transform="log", low=-9.0, high=9.0, variable_name=key
    )
    return SimpleNamespace(
        problem=SimpleNamespace(keys=[key], parameters=[parameter]),
        ladder=[SimpleNamespace(sd=0.1, ratio=1.0, components={key: 1.0})],
        profiles={key: (side, side)},
        intervals=[SimpleNamespace(estimate=1.0, status="determined")],
        best=SimpleNamespace(u=np.zeros(1)),
        file=SimpleNamespace(units=Units()),
        points=np.random.default_rng(1).normal(size=(200, 1)),
    )


@pytest.mark.parametrize(
    "draw", [profiles_figure, identifiability_figure, posterior_figure]
)
def test_titles_of_a_fit_of_one_key_are_within_the_page(draw):
    """All words are there, in lines that make the page higher than a short title does,
    the control."""
    figure, short = draw(one_key(), LONG), draw(one_key(), "T")
    saved(figure)
    title = figure.get_suptitle()
    said = short.get_suptitle().replace("\n", " ").removeprefix("T: ")
    assert title.replace("\n", " ") == f"{LONG}: {said}"
    (drawn,) = figure.findobj(lambda one: getattr(one, "get_text", str)() == title)
    extent = drawn.get_window_extent()
    assert 0 < extent.x0 < extent.x1 < figure.bbox.x1
    highest = max(axes.get_window_extent().y1 for axes in figure.axes)
    assert highest < extent.y0 < extent.y1 < figure.bbox.y1
    assert figure.get_figheight() > short.get_figheight()


@pytest.fixture
def record(tmp_path):
    """The run file of a record without units, of a step or with a hold."""

    def made(velocities, at):
        ends = np.diff([0.0, *at, 50.0])
        steps = zip(velocities, ends, strict=True)
        step = Programme([Segment(v, time=t) for v, t in steps])
        t = np.linspace(0.0, 50.0, 51)
        law = RateAndState(a=0.01, b=0.015, D_c=10.0, stiffness=0.01, mu_0=0.6)
        rows = [
            f"{x},{mu},1e-4" for x, mu in zip(t, law.friction(step, t), strict=True)
        ]
        (tmp_path / "step.csv").write_text("\n".join(["t,mu,error", *rows]))
        return record_of(tmp_path / "step.csv", velocities=velocities, at=at)

    return made


@pytest.mark.parametrize(
    ("velocities", "at", "label", "unit"),
    [
        ([1.0, 10.0], [20.0], "displacement of the load point", "um"),
        ([1.0, 0.0, 1.0], [20.0, 30.0], "time  $t$", "s"),
    ],
    ids=["step", "hold"],
)
def test_a_record_without_contacts_has_no_natural_units(
    record, velocities, at, label, unit
):
    """Neither x_* nor omega exists; units that are given are shown, and the contacts of
    the same run file have theirs (controls)."""
    file = record(velocities, at)
    given = {"length": "um", "time": "s"}
    for changes, end in (({}, ""), (given, f"  [{unit.replace('u', 'µ')}]")):
        known = check({**file.given, "units": changes}, file.folder)
        found = fit_rate_and_state(known, stiffness=0.01, starts=1)
        figure = compared_figure({"slip law": found}, "")
        assert figure.axes[-1].get_xlabel() == label + end
    (panel,) = data_figure(prepare(file, None, False), "").axes
    assert panel.get_xlabel() == r"time  $t$  [$1 / \omega$]"
