"""Pictures of chains of blocks in time."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import animation
from matplotlib.figure import Figure

from eqsim.catalogue import RATE, TIME, VELOCITY
from eqsim.io.labels import unit_text
from eqsim.plots.panels import DOTS, Caption
from eqsim.plots.style import styled, wrap_titles

if TYPE_CHECKING:
    from eqsim.engine.chain_records import ChainTrajectory

_MOST_FRAMES = 200  # of a film, which takes some minutes at most


@styled
def chain_figure(run: "ChainTrajectory", caption: Caption) -> Figure:
    """Draw the force of the springs that drive, and of the contacts, against time, with
    events of all blocks; below, how far blocks are apart."""
    figure = Figure(figsize=(8, 5.5))
    top, low = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1.0])
    top.plot(run.t, run.spring, label="springs that drive")
    top.plot(run.t, run.force, color="C1", linewidth=0.8, label="contacts")
    events = run.events
    one = f", in one of {caption.replicas} replicas" * (caption.replicas > 1)
    whole = events["blocks"] == run.chain.count
    for chosen, label, marker in (
        (whole, f"event of all blocks{one}", "v"),
        (~whole & events["ended"], f"precursor{one}", "|"),
    ):
        if chosen.any():
            place = events["t"][chosen], events["peak"][chosen]
            top.plot(*place, label=label, **DOTS | {"color": "C3", "marker": marker})
    top.set(ylabel=caption.force)
    if top.dataLim.y0 >= 0:
        top.set_ylim(bottom=0)
    caption.beside(top)
    top.set_title(caption.heading)
    top.legend(loc="best", title=caption.means or None)
    low.plot(run.t, run.roughness, color="C2")
    low.set(xlabel=caption.along("t"), xlim=(run.t[0], run.t[-1]), ylim=(0, None))
    low.set_ylabel(caption.unit("spread of $X$\nbetween blocks"))
    return figure


@styled
def fronts_figure(run: "ChainTrajectory", caption: Caption) -> Figure:
    """Draw the blocks that break in each event of the replica that has the event with
    most blocks against time, and this one closely, with the straight lines of its
    fronts."""
    figure = Figure(figsize=(10, 4.6))
    left, right = figure.subplots(1, 2)
    count, most = run.chain.count, np.argmax(run.events["blocks"])
    largest, replica = run.events["event"][most], run.events["replica"][most]
    broke, fronts = (
        {name: column[table["replica"] == replica] for name, column in table.items()}
        for table in (run.broke, run.fronts)
    )
    left.plot(broke["t"], broke["block"], ".", color="C0", markersize=3)
    left.set(xlabel=caption.along("t"), ylabel="block", xlim=(run.t[0], run.t[-1]))
    one = f", replica {replica}" * (caption.replicas > 1)
    left.set(ylim=(-0.5, count - 0.5), title=f"blocks that break{one}")
    here = broke["event"] == largest
    begin = float(broke["t"][here].min())
    right.plot(broke["t"][here] - begin, broke["block"][here], **DOTS)
    mine = np.flatnonzero(fronts["event"] == largest)
    rate = unit_text(caption.units, RATE, unknown=False) or "1/time"
    unit = f"blocks {rate}".replace(" 1/", "/")
    for color, i in zip(("C3", "C1"), mine, strict=False):
        speed, error = fronts["speed"][i], fronts["speed_stderr"][i]
        steps = np.arange(fronts["blocks"][i])
        along = fronts["t"][i] - begin + steps / speed
        blocks = (fronts["block"][i] + fronts["direction"][i] * steps) % count
        blocks = np.where(
            np.abs(np.diff(blocks, prepend=blocks[0])) > 1, np.nan, blocks
        )
        label = f"{speed:.3g} ± {error:.1g} {unit}, {run.kind_of(speed)}"
        right.plot(along, blocks, color=color, linewidth=1, label=label)
    since = caption.unit("time since the first block broke", TIME, unknown=True)
    right.set(xlabel=since, ylabel="block")
    right.set(ylim=(-0.5, count - 0.5), title="the largest event")
    if mine.size:
        right.legend(loc="best")
    for axes in (left, right):
        axes.yaxis.get_major_locator().set_params(integer=True)
    figure.suptitle(caption.heading)
    return figure


@styled
def animation_of(run: "ChainTrajectory", caption: Caption) -> Any:
    """Show forces and velocities of the blocks of the first replica, one record after
    the other."""
    figure = Figure(figsize=(7, 5))
    top, low = figure.subplots(2, 1, sharex=True)
    force, V = run.in_space("force"), run.in_space("V")
    blocks = np.arange(run.chain.count)
    lines = [
        axes.plot(blocks, column[0], color=color, marker=".")[0]
        for axes, column, color in ((top, force, "C0"), (low, V, "C3"))
    ]
    for axes, column in ((top, force), (low, V)):
        axes.set_ylim(min(0.0, column.min()), 1.05 * max(column.max(), 1e-300))
    top.set(ylabel=caption.force, title=caption.heading)
    wrap_titles(figure)
    velocity = caption.unit("velocity of the block", VELOCITY, unknown=True)
    low.set(xlabel="block", ylabel=velocity)
    unit = unit_text(caption.units, TIME, unknown=False)
    clock = top.text(0.02, 0.9, "", transform=top.transAxes)

    def show(record: int) -> list[Any]:
        lines[0].set_ydata(force[record])
        lines[1].set_ydata(V[record])
        clock.set_text(f"$t$ = {run.t[record]:.4g} {unit}".rstrip())
        return [*lines, clock]

    records = np.unique(np.linspace(0, run.t.size - 1, _MOST_FRAMES).astype(int))
    return animation.FuncAnimation(figure, show, frames=records.tolist(), interval=50)
