"""The public names of eqsim: all that do not begin with an underscore."""

from typing import Any as _Any
from typing import cast as _cast

from eqsim import calls as _calls
from eqsim.engine import breaks as _breaks
from eqsim.engine import elastic as _elastic
from eqsim.engine import steady as _steady
from eqsim.engine import trajectory as _trajectory
from eqsim.engine.breaks import Breaks as Breaks
from eqsim.engine.chain_records import ChainTrajectory as ChainTrajectory
from eqsim.engine.records import ElasticTrajectory as ElasticTrajectory
from eqsim.engine.records import ProgrammeTrajectory as ProgrammeTrajectory
from eqsim.engine.records import SliderTrajectory as SliderTrajectory
from eqsim.engine.records import Slip as Slip
from eqsim.engine.records import Trajectory as Trajectory
from eqsim.engine.steady import Steady as Steady
from eqsim.errors import InputError as InputError
from eqsim.estimate import OBSERVABLES as OBSERVABLES
from eqsim.estimate import Estimate as Estimate
from eqsim.estimate import z_score as z_score
from eqsim.fitting import fit as _fit
from eqsim.fitting import rate_and_state as _rate_and_state
from eqsim.fitting.fit import FitResult as FitResult
from eqsim.fitting.posterior import Posterior as Posterior
from eqsim.fitting.posterior import posterior as posterior
from eqsim.fitting.rate_and_state import RateAndStateFit as RateAndStateFit
from eqsim.fitting.rate_and_state import record_of as record_of
from eqsim.io.runfile import RunFile as RunFile
from eqsim.io.runfile import load as load
from eqsim.io.units import Interface as Interface
from eqsim.io.units import Units as Units
from eqsim.laws.aging import Aging as Aging
from eqsim.laws.delay import Delay as Delay
from eqsim.laws.named import Exponential as Exponential
from eqsim.laws.named import Lognormal as Lognormal
from eqsim.laws.named import Normal as Normal
from eqsim.laws.named import Pareto as Pareto
from eqsim.laws.named import Uniform as Uniform
from eqsim.laws.named import Weibull as Weibull
from eqsim.laws.newborn import Newborn as Newborn
from eqsim.laws.no_thresholds import NoThresholds as NoThresholds
from eqsim.laws.thermal import Pathway as Pathway
from eqsim.laws.thermal import Thermal as Thermal
from eqsim.laws.threshold import Delta as Delta
from eqsim.laws.threshold import Distribution as Distribution
from eqsim.laws.threshold import Gamma as Gamma
from eqsim.laws.threshold import Table as Table
from eqsim.laws.viscosity import Viscosity as Viscosity
from eqsim.master import bursts as _bursts
from eqsim.master import chain_modes as _chain_modes
from eqsim.master import closure as _closure
from eqsim.master import lifetimes as _lifetimes
from eqsim.master import stability as _stability
from eqsim.master import steady as _exact
from eqsim.master import transient as _transient
from eqsim.master.bursts import Bursts as Bursts
from eqsim.master.chain_fronts import front_prestress as front_prestress
from eqsim.master.chain_fronts import front_speed as front_speed
from eqsim.master.chain_modes import Modes as Modes
from eqsim.master.chains import Precursors as Precursors
from eqsim.master.chains import edge_load as edge_load
from eqsim.master.chains import precursors as precursors
from eqsim.master.closure import Closure as Closure
from eqsim.master.lifetimes import Lifetime as Lifetime
from eqsim.master.programme import Transient as Transient
from eqsim.master.stability import FreshSlip as FreshSlip
from eqsim.master.stability import Stability as Stability
from eqsim.master.steady import Curve as Curve
from eqsim.master.steady import Reference as Reference
from eqsim.master.transient import Fluctuations as Fluctuations
from eqsim.model.chain import Chain as Chain
from eqsim.model.drive import Drive as Drive
from eqsim.model.drive import Programme as Programme
from eqsim.model.drive import Segment as Segment
from eqsim.model.drive import Stage as Stage
from eqsim.model.elastic import Elastic as Elastic
from eqsim.model.ensemble import Ensemble as Ensemble
from eqsim.model.ensemble import Population as Population
from eqsim.rate_and_state import RateAndState as RateAndState
from eqsim.validation import Validation as Validation
from eqsim.validation import validate as validate
from eqsim.workflows import run as _run
from eqsim.workflows import sweep as _sweep
from eqsim.workflows.replay import Replay as Replay
from eqsim.workflows.replay import replay as replay
from eqsim.workflows.run import RunResult as RunResult

# these take a run file, too, in the place of contacts and a drive
breaks = _calls.accepts_run_file(_breaks.breaks)
_SIZES = range(1, 1001)  # of bursts
bursts = _calls.accepts_run_file(_bursts.bursts, lambda file: _SIZES, output=())
chain_modes = _calls.accepts_run_file(_chain_modes.chain_modes)
closure = _calls.accepts_run_file(_closure.closure)
curve: _calls.CurveCall = _cast(
    _Any, _calls.accepts_run_file(_exact.curve, _calls.swept_velocities)
)
elastic_trajectory = _calls.accepts_run_file(_elastic.elastic_trajectory)
fluctuations = _calls.accepts_run_file(
    _transient.fluctuations, _calls.over_cycles, output=()
)
fresh_slip = _calls.accepts_run_file(_stability.fresh_slip)
lifetime = _calls.accepts_run_file(_lifetimes.lifetime)
reference = _calls.accepts_run_file(_exact.reference)
stability = _calls.accepts_run_file(_stability.stability)
steady = _calls.accepts_run_file(_steady.steady)
trajectory = _calls.depends_on_drive(_trajectory.trajectory)
transient = _calls.accepts_run_file(_transient.transient)

# these take changes of keys beside a run file
fit = _calls.accepts_changes(_fit.fit)
fit_rate_and_state = _calls.accepts_changes(_rate_and_state.fit_rate_and_state)
run = _calls.accepts_changes(_run.run)
sweep = _calls.accepts_changes(_sweep.sweep)
