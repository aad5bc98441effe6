"""The public names of eqsim."""

from typing import Any, cast

from eqsim import calls
from eqsim.engine import breaks as _breaks
from eqsim.engine import elastic as _elastic
from eqsim.engine import steady as _steady
from eqsim.engine import trajectory as _trajectory
from eqsim.engine.breaks import Breaks
from eqsim.engine.chain_records import ChainTrajectory
from eqsim.engine.records import (
    ElasticTrajectory,
    ProgrammeTrajectory,
    SliderTrajectory,
    Slip,
    Trajectory,
)
from eqsim.engine.steady import Steady
from eqsim.errors import InputError
from eqsim.estimate import OBSERVABLES, Estimate, z_score
from eqsim.fitting import fit as _fit
from eqsim.fitting import rate_and_state as _rate_and_state
from eqsim.fitting.fit import FitResult
from eqsim.fitting.posterior import Posterior, posterior
from eqsim.fitting.rate_and_state import RateAndStateFit, record_of
from eqsim.io.runfile import RunFile, load
from eqsim.io.units import Interface, Units
from eqsim.laws.aging import Aging
from eqsim.laws.delay import Delay
from eqsim.laws.named import Exponential, Lognormal, Normal, Pareto, Uniform, Weibull
from eqsim.laws.newborn import Newborn
from eqsim.laws.no_thresholds import NoThresholds
from eqsim.laws.thermal import Pathway, Thermal
from eqsim.laws.threshold import Delta, Distribution, Gamma, Table
from eqsim.laws.viscosity import Viscosity
from eqsim.master import bursts as _bursts
from eqsim.master import chain_modes as _chain_modes
from eqsim.master import closure as _closure
from eqsim.master import lifetimes as _lifetimes
from eqsim.master import stability as _stability
from eqsim.master import steady as _exact
from eqsim.master import transient as _transient
from eqsim.master.bursts import Bursts
from eqsim.master.chain_fronts import front_prestress, front_speed
from eqsim.master.chain_modes import Modes
from eqsim.master.chains import Precursors, edge_load, precursors
from eqsim.master.closure import Closure
from eqsim.master.lifetimes import Lifetime
from eqsim.master.stability import FreshSlip, Stability
from eqsim.master.steady import Curve, Reference
from eqsim.master.transient import Fluctuations, Transient
from eqsim.model.chain import Chain
from eqsim.model.drive import Drive, Programme, Segment, Stage
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Ensemble, Population
from eqsim.rate_and_state import RateAndState
from eqsim.validation import Validation, validate
from eqsim.workflows import run as _run
from eqsim.workflows import sweep as _sweep
from eqsim.workflows.replay import Replay, replay
from eqsim.workflows.run import RunResult

__all__ = [
    "OBSERVABLES",
    "Aging",
    "Breaks",
    "Bursts",
    "Chain",
    "ChainTrajectory",
    "Closure",
    "Curve",
    "Delay",
    "Delta",
    "Distribution",
    "Drive",
    "Elastic",
    "ElasticTrajectory",
    "Ensemble",
    "Estimate",
    "Exponential",
    "FitResult",
    "Fluctuations",
    "FreshSlip",
    "Gamma",
    "InputError",
    "Interface",
    "Lifetime",
    "Lognormal",
    "Modes",
    "Newborn",
    "NoThresholds",
    "Normal",
    "Pareto",
    "Pathway",
    "Population",
    "Posterior",
    "Precursors",
    "Programme",
    "ProgrammeTrajectory",
    "RateAndState",
    "RateAndStateFit",
    "Reference",
    "Replay",
    "RunFile",
    "RunResult",
    "Segment",
    "SliderTrajectory",
    "Slip",
    "Stability",
    "Stage",
    "Steady",
    "Table",
    "Thermal",
    "Trajectory",
    "Transient",
    "Uniform",
    "Units",
    "Validation",
    "Viscosity",
    "Weibull",
    "breaks",
    "bursts",
    "chain_modes",
    "closure",
    "curve",
    "edge_load",
    "elastic_trajectory",
    "fit",
    "fit_rate_and_state",
    "fluctuations",
    "fresh_slip",
    "front_prestress",
    "front_speed",
    "lifetime",
    "load",
    "posterior",
    "precursors",
    "record_of",
    "reference",
    "replay",
    "run",
    "stability",
    "steady",
    "sweep",
    "trajectory",
    "transient",
    "validate",
    "z_score",
]  # fmt: skip

# these take a run file, too, in the place of contacts and a drive
breaks = calls.accepts_run_file(_breaks.breaks)
bursts = calls.accepts_run_file(_bursts.bursts, calls.many_sizes, output=())
chain_modes = calls.accepts_run_file(_chain_modes.chain_modes)
closure = calls.accepts_run_file(_closure.closure)
curve: calls.CurveCall = cast(
    Any, calls.accepts_run_file(_exact.curve, calls.swept_velocities)
)
elastic_trajectory = calls.accepts_run_file(_elastic.elastic_trajectory)
fluctuations = calls.accepts_run_file(
    _transient.fluctuations, calls.over_cycles, output=()
)
fresh_slip = calls.accepts_run_file(_stability.fresh_slip)
lifetime = calls.accepts_run_file(_lifetimes.lifetime)
reference = calls.accepts_run_file(_exact.reference)
stability = calls.accepts_run_file(_stability.stability)
steady = calls.accepts_run_file(_steady.steady)
trajectory = calls.depends_on_drive(_trajectory.trajectory)
transient = calls.accepts_run_file(_transient.transient)

# these take changes of keys beside a run file
fit = calls.accepts_changes(_fit.fit)
fit_rate_and_state = calls.accepts_changes(_rate_and_state.fit_rate_and_state)
run = calls.accepts_changes(_run.run)
sweep = calls.accepts_changes(_sweep.sweep)
