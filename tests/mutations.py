"""Deliberate mistakes, one at a time: does a test notice?

    python tests/mutations.py [--list] [--only PART ...] [--whole] [--json FILE]

Each mistake of `MISTAKES` is made in a temporary copy of the repository, where the
tests nearest to it are run with all their cases, and with --whole the default suite if
these pass. A table says which test caught it. Exit code 1 if one survives, 2 if a
mistake cannot be made (its text is not there once) or its tests fail without it.
Mistakes in compiled code take as long as kernels take to compile, a minute or so each;
those in plain Python some seconds.
"""

import argparse
import ast
import functools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
LONGEST = 1800.0  # seconds that tests may take; a mistake without an end is caught
# Modules that compile: what a file imports from one of these may, as a decorator, make
# machine code of a function.
COMPILERS = ("eqsim.numerics.compiled", "numba", "llvmlite")


class Mistake(NamedTuple):
    """A name, the file below eqsim/, the text that occurs there once and what takes its
    place, and the tests nearest to it, by the names of their files, separated by " & ". `same` says
    why the program does the same with it, if it does."""

    name: str
    file: str
    old: str
    new: str
    tests: str
    same: str = ""


class Fate(NamedTuple):
    """What became of a mistake: "caught", "SURVIVED" or "equivalent"; by which test and
    what that said, or why; and the seconds it took."""

    name: str
    fate: str
    by: str
    seconds: float


M = Mistake
# fmt: off
MISTAKES = [
    # laws
    M("gamma: power of the density", "laws/threshold.py", "(1 + 2 * self.n) * np.log(inside)",
      "(2 * self.n) * np.log(inside)",
      "test_threshold.py::test_gamma_is_nakagami"),
    M("gamma: rms threshold", "laws/threshold.py", "self.x_star * math.sqrt(self.n + 1.0)",
      "self.x_star * math.sqrt(self.n + 0.9)", "test_threshold.py::test_gamma_is_nakagami"),
    M("gamma: slopes of the table", "laws/threshold.py", "slope = 0.5 * np.exp(log", "slope = 0.6 * np.exp(log",
      "test_threshold.py::test_draw_is_the_quantile"),
    M("lognormal: width of the survival", "laws/named.py", "special.ndtr(-np.log(u) / self.sigma)",
      "special.ndtr(-np.log(u) / self.sigma * 1.01)", "test_named.py::test_against_scipy"),
    M("normal: the cut is forgotten", "laws/named.py", "special.ndtri_exp(special.log_ndtr(z) - e)",
      "special.ndtri_exp(-e)", "test_named.py::test_quantile_inverts_the_survival"),
    M("laws with a density: error of the table is not quoted", "engine/errorbars.py",
      "means = max(means, law.drawn_to)", "pass",
      "test_steady.py::test_jumps_of_the_density_count_in_error_bars"),
    M("breaks: stretch at birth is forgotten", "engine/breaks.py",
      "lives.birth[r, i] + lives.travel[r, i]", "lives.travel[r, i]",
      "test_outputs.py::test_breaks_make_the_force"),
    M("breaks: rows without room are lost", "engine/breaks.py",
      "if size <= listed.rows.size:", "if True:",
      "test_outputs.py::test_breaks_do_not_depend_on_threads_or_on_room"),
    M("fluctuations: of products, not about the mean", "workflows/fluctuations.py", "run.force_replicas - level",
      "run.force_replicas", "test_outputs.py::test_fluctuations_of_simulated_contacts"),
    M("distributions: an infinite quantile is none", "laws/threshold.py", "lost = ~np.isfinite(xi) | (", "lost = (",
      "test_threshold.py::test_laws_whose_tail_scipy_does_not_know"),
    M("distributions: a quantile without density is one", "laws/threshold.py",
      "law.pdf(xi) + law.sf(xi) == 0.0", "law.pdf(xi) < 0.0",
      "test_threshold.py::test_laws_whose_tail_scipy_does_not_know"),
    M("discrete thresholds: ranks", "laws/threshold.py", "return self.steps[self.steps.size - 1 - np.minimum",
      "return self.steps[np.minimum", "test_threshold.py::test_discrete_laws"),
    M("discrete thresholds: drawn in reverse", "laws/threshold.py", "return law.steps[law.steps.size - 1 - np.int64(",
      "return law.steps[np.int64(",
      "test_threshold.py::test_ranks_are_equally_likely & test_threshold.py::test_table_draws"),
    M("direct draws: 1 % low", "laws/threshold.py", "return math.sqrt(-log(p))", "return 0.99 * math.sqrt(-log(p))",
      "test_lives.py::test_direct_draws_have_the_law_of_the_table"),
    M("distributions: error of jumps without the cube", "laws/threshold.py", "self._drawn_to(1, 3, rarest=40.0)",
      "self._drawn_to(1, 1, rarest=40.0)",
      "test_threshold.py::test_error_of_draws_across_a_gap_that_is_not_told"),
    M("aging: rates of bonds as if an attempt frequency bounded them", "master/flow.py",
      "greatest = np.maximum(greatest, contacts.barrier.log_w)", "greatest = contacts.barrier.log_w + 0.0 * greatest",
      "test_bonds.py::test_hazards_of_bonds_that_age_as_the_logarithm_of_time"),
    M("annealed: laws that no contact reaches drown the others", "master/annealed.py",
      "np.array([_LONGEST_LIFE])", "np.array([math.inf])",
      "test_reference.py::test_bonds_that_break_long_before_they_have_aged"),
    M("annealed: off-rates of bonds are polynomials themselves", "master/annealed.py",
      "if self.ages and self.contacts.barrier.by_force:", "if self.ages and False:",
      "test_reference.py::test_bonds_that_live_to_age"),
    M("annealed: no rare strong contacts in the mean off-rate", "laws/barrier/pooled.py",
      "ranks = FAR_RANKS_ABOVE if", "ranks = RANKS_ABOVE if",
      "test_bonds.py::test_rare_strong_contacts_set_the_mean_off_rate & "
      "test_bonds.py::test_bonds_that_age_and_pull_harder"),
    M("transients: first lives end in the middle of cells", "master/transient.py",
      "late[np.abs(late) < _ROUNDED * np.abs(falling).max()] = 0.0", "late[:] = 0.0",
      "test_convolution.py::test_transients_and_fluctuations_of_two_thresholds & "
      "test_convolution.py::test_first_breaks_beyond_a_jump_of_the_density"),
    M("fronts: no panels where damping outweighs springs", "master/chain_fronts.py", "if slowest < edges[1]:",
      "if slowest < 0.0:", "test_chain_fronts.py::test_fast_fronts_of_heavily_damped_blocks"),
    M("fronts: series that begin before inertia exceeds damping", "master/chain_fronts.py",
      "first = max(first, min(heavy, _MOST_PERIODS // 4))", "first = max(first, 1)",
      "test_chain_fronts.py::test_fast_fronts_of_heavily_damped_blocks"),
    M("newborn: births at a discrete threshold", "master/newborn.py", "_BELOW = 1e-13", "_BELOW = 0.0",
      "test_newborn_reference.py::test_births_right_below_a_discrete_threshold"),
    M("delays: the saddle serves broad laws, too", "laws/delay.py", "_BROAD = 1.0", "_BROAD = 1e9",
      "test_delay_laws.py::test_transform_of_lognormal_delays_at_complex_rates"),
    M("stationary: the last ones reach their thresholds", "engine/stationary.py",
      "np.where(last < top, ends, stretch)", "ends",
      "test_trajectory.py::test_stationary_starts_of_contacts_that_heat_breaks_at_once"),
    M("annealed: steep off-rates in as many steps", "laws/barrier/pooled.py", "_STEEPEST = 60.0",
      "_STEEPEST = 0.0", "test_bonds.py::test_steep_off_rates_of_gamma_laws"),
    M("slider: what no replica has met is not", "engine/slider_runs.py",
      'unmet_force(mean["variance"], mean["friction"], contacts) / replicas', '0.0 * mean["variance"]',
      "test_slider.py::test_few_replicas_of_few_contacts_have_errors"),
    M("programmes: a stationary start is what steps make of it", "master/programme.py",
      "errors += missed[:, None]", "errors += 0.0 * missed[:, None]",
      "test_programme_reference.py::test_stationary_starts_of_contacts_that_hardly_move"),
    M("slips: short records have no bias", "engine/records.py", "math.hypot(math.sqrt(variance / n), short)",
      "math.sqrt(variance / n)", "test_slider.py::test_periods_of_short_records"),
    M("steady: no clock beyond 40 is missed", "engine/proposal.py",
      "covered &= bool(part[-1] <=", "covered &= bool(0.0 * part[-1] <=",
      "test_bonds.py::test_catch_bonds_that_few_outlive"),
    M("catch bonds: panels between levels of the hazard alone", "master/quenched.py",
      "bare.ends_of_panels(levels, xi, a)", "bare.stretch_at(levels, xi, a)",
      "test_bonds.py::test_catch_bonds_that_little_force_holds"),
    M("distributions: slope of a bin taken from the next", "laws/threshold.py", "xi[1:] * (1.0 - _ASIDE)",
      "xi[1:] * (1.0 + _ASIDE)", "test_threshold.py::test_draws_beside_jumps_and_across_gaps"),
    M("distributions: cells that end at jumps are searched for one life only", "engine/lanes.py",
      "law.steps.size > 0 or law.ranks.size > 0", "law.steps.size > 0",
      "test_trajectory.py::test_forces_beyond_a_gap_between_thresholds"),
    M("sqrt law: root of the threshold", "laws/stiffness.py", "return xi / xi_rms if", "return (xi / xi_rms) ** 0.5 if",
      "test_delay_stiffness.py::test_sqrt_law_is_the_root_of_the_force"),
    M("sqrt law: kernel", "laws/stiffness.py", "return springs.constant + springs.slope * xi",
      "return springs.constant + springs.slope * xi * xi",
      "test_delay_stiffness.py::test_kernel_stiffness"),
    M("delay: exponential 2 % long", "laws/delay.py", "law.random - law.random * log(u)",
      "law.random - 1.02 * law.random * log(u)",
      "test_delay_stiffness.py::test_a_uniform_is_the_share_of_longer_delays"),
    M("delay: no residual of a fixed one", "laws/delay.py", "return (law.mean - law.random) * u -",
      "return law.mean - law.random -",
      "test_delay_stiffness.py::test_residual_draws"),
    M("tables: slopes limited too much", "numerics/tables.py", "limit = 3.0 * rise", "limit = 1.0 * rise",
      "test_octaves.py"),
    M("tables: no constant beyond the last cell", "numerics/tables.py", "t = 1.0", "t = 0.0",
      "test_octaves.py::test_beyond_the_ends"),
    M("log of 1 + t: what is lost", "numerics/vector_math.py", "f + (t - (u - 1.0))", "f + 0.0 * (t - (u - 1.0))",
      "test_elementary.py::test_stated_error"),
    M("sine: thirteenth digit", "numerics/vector_math.py", "-0.6459640975062232", "-0.6459640975064232",
      "test_elementary.py::test_stated_error"),
    M("stiff hazard: factor", "laws/barrier/stiff.py", "math.log(2 / 3)", "math.log(3 / 2)",
      "test_thermal.py::test_derivative_of_the_hazard_is_the_rate"),
    M("stiff rate: root of the gap", "laws/barrier/stiff.py", "return np.sqrt(gap / xi)",
      "return gap / xi", "test_thermal.py::test_derivative_of_the_hazard_is_the_rate"),
    M("soft inverse: a factor sqrt(a)", "laws/barrier/soft.py", "_SOFT * clock * root *", "_SOFT * clock *",
      "test_thermal.py::test_inverse_is_the_inverse_of_the_hazard"),
    M("stiff inverse: 1 - q", "laws/barrier/stiff.py", "x = xi * spent * (2.0 - spent) /", "x = xi * spent * 2.0 /",
      "test_thermal.py::test_inverse_is_the_inverse_of_the_hazard"),
    M("cusp hazard: factor", "laws/barrier/cusp.py", "log_share - np.log(2.0 * a", "log_share - np.log(a",
      "test_thermal.py::test_log_hazard_is_the_integral_of_the_rate"),
    M("cusp inverse: cancelled root", "laws/barrier/cusp.py", "1.0 + math.sqrt(left))) if",
      "1.0 + math.sqrt(1.0 - spent))) if",
      "test_thermal.py::test_inverse_is_the_inverse_of_the_hazard"),
    M("cusp, way back: to the clock, not to 0", "laws/barrier/cusp.py", "rise / (gap + math.sqrt(gap * gap + rise))",
      "rise / (2.0 * gap)",
      "test_newborn.py::test_travel"),
    M("Bell, way back: as ahead", "laws/barrier/bell.py", "-math.log1p(-odds)",
      "math.log1p(odds)",
      "test_bonds.py::test_lives_by_quadrature"),
    M("Bell: rate at the wrong end", "laws/barrier/bell.py", "law.b * k * x + way, MOST",
      "law.b * k * x, MOST",
      "test_bonds.py::test_extreme_force_scales"),
    M("catch-slip: both pathways opened by force", "laws/barrier/catch_slip.py",
      "self.log_catch + log_mean(-self.catch", "self.log_catch + log_mean(self.catch",
      "test_bonds.py::test_rupture_force_on_a_ramp"),
    M("no thresholds: jumps", "laws/no_thresholds.py", "law.steps.size > 0 and not", "law.steps.size > 0 or not",
      "test_bonds.py::test_results_do_not_depend_on_the_unit_of_length"),
    M("pooled inverse: below the first node", "laws/barrier/pooled.py", "return x[0] * (target / G[0])",
      "return x[0]", "test_thermal.py::test_pooled_stretch_at_its_ends"),
    M("pooled rate: soft exponent", "laws/barrier/pooled.py", "(beyond, beyond + 2 * y, xi, a)",
      "(beyond, beyond + y, xi, a)", "test_thermal.py::test_pooled_rate_is_nt08"),
    M("pooled table: rate right of a node", "laws/barrier/pooled.py", "right[:k] += rate[:-1]",
      "right[:k] += 0.9 * rate[:-1]", "test_thermal.py::test_documented_error_of_the_pool_of_a_table"),
    M("aging: alpha by a half", "laws/aging/__init__.py", "4.0 * self.rate", "2.0 * self.rate",
      "test_aging.py::test_alpha"),
    M("pooled births: slopes of another unit", "laws/aging/pooled.py", "np.exp(-e) / self.pdf(xi) / self.scale",
      "np.exp(-e) / self.pdf(xi)", "test_aging.py::test_pooled_table_in_any_unit"),
    M("pooled births: mean", "laws/aging/pooled.py", "(share @ np.sqrt(square))", "np.sqrt(share @ square)",
      "test_aging.py::test_pooled_limits"),
    M("flow: work", "laws/aging/flow.py", "(excess(t) - 2.0 * mean) / t)", "(excess(t) - mean) / t)",
      "test_aging.py::test_flow_work"),
    M("flow: growth without its end", "laws/aging/flow.py", "(law.final2 - 1.0) * math.expm1(-law.alpha * x))",
      "(law.final2 - 1.0) * -law.alpha * x)", "test_aging.py::test_flow_stretch_in_an_ode"),
    M("logarithmic: root too early", "laws/aging/logarithmic.py", "if not step < x * (1.0 - 2e-16):",
      "if not step < x * (1.0 - 1e-2):", "test_logarithmic.py::test_root_is_lamberts"),
    M("logarithmic: t_c by its inverse", "laws/aging/logarithmic.py", "return cls(aging.beta, 1.0 / slid)",
      "return cls(aging.beta, slid)", "test_logarithmic.py::test_numbers"),
    M("logarithmic: cells do not see t_c", "laws/aging/logarithmic.py",
      "return law.per_time * (x1 - x0) <= 2.0 * (1.0 + law.per_time * x0)", "return True",
      "test_logarithmic.py::test_lives_spend_their_clocks"),
    M("paths of aging: stiffness of now", "laws/aging/base.py", "    return kappa(springs, born)\n",
      "    return kappa(springs, now)\n", "test_logarithmic.py::test_lives_spend_their_clocks"),
    M("paths of aging: no cell narrower than 2^-60", "laws/aging/along.py", "_DEEPEST = 1000", "_DEEPEST = 60",
      "test_logarithmic.py::test_lives_that_flow_at_once"),
    M("paths of aging: cells too wide", "laws/aging/along.py", "_RANGE = 4.0", "_RANGE = 400.0",
      "test_aging.py::test_flow_stretch_in_an_ode & test_aging.py::test_flow_without_aging"),
    M("paths of aging: Jacobian of the hazard", "laws/aging/along.py", "* 2.0 * c.end * (1.0 - z)", "* 2.0 * c.end",
      "test_aging.py::test_flow_without_aging"),
    # streams
    M("sobol: direction numbers in their own order", "numerics/sobol.py", "words[..., 1:] ^= words[..., :-1]",
      "words[..., 1:] ^= 0", "test_sobol.py"),
    M("sobol: blocks begin anew", "numerics/sobol.py", "if first >> k & 1:", "if False:", "test_sobol.py"),
    M("kernels: damaged code is taken", "numerics/kernel_folder.py",
      "if not _note(folder).exists() or _note(folder).read_bytes() != checksum:", "if not _note(folder).exists():",
      "test_kernel_files.py::test_damaged_files_are_compiled_again"),
    M("kernels: nobody waits", "numerics/kernel_folder.py", "lock.acquire(timeout=_PATIENCE",
      "lock.acquire(timeout=0.0", "test_kernel_files.py::test_a_process_waits_for_the_one_that_compiles"),
    M("kernels: a full disk ends a run", "numerics/compiled.py", "except (OSError, RuntimeError):",
      "except RuntimeError:", "test_kernel_files.py::test_a_full_disk"),
    M("kernels: arrays of any order are alike", "numerics/compiled.py",
      "order, flags.writeable, flags.aligned", "flags.writeable, flags.aligned",
      "test_kernel_files.py::test_values_of_one_kind_have_one_type"),
    M("streams: nine rounds", "numerics/streams.py", "for _ in range(10):", "for _ in range(9):",
      "test_streams.py::test_known_answers"),
    M("streams: 32-bit uniforms", "numerics/streams.py",
      "bits = (low | (high << _HALF)) >>", "bits = (high << _HALF) >>",
      "test_streams.py::test_tail_is_resolved_below_a_double_near_1"),
    M("streams: contacts beyond 2^32 repeat", "numerics/streams.py", "return philox(c & _LOW, c >> _HALF, j",
      "return philox(c & _LOW, c & _LOW, j", "test_streams.py::test_layout_of_the_counter"),
    M("streams: paths share counters with lives", "numerics/streams.py", "| np.uint64(0x80000000)", "| np.uint64(0)",
      "test_streams.py::test_words_have_counters_of_their_own"),
    M("streams: small products stay coarse", "numerics/streams.py", "    u, v = uniforms(key, contact, life, draw)\n",
      "    u, v = 0.5, 0.5\n", "test_streams.py::test_small_products_are_refined_within_their_cells"),
    M("streams: one key for all purposes", "numerics/streams.py", "SeedSequence((seed, purpose))",
      "SeedSequence((seed, 1))", "test_streams.py::test_key_is_what_numpy_makes_of_seed_and_purpose"),
    # lives
    M("lives: both rounds alike at T > 0", "engine/lanes.py",
      "ROUNDS * age[i] + r if heat", "ROUNDS * age[i] if heat",
      "test_lives.py::test_lives_have_the_law_of_the_twin[uniform-0.3-soft-1.0]"),
    M("lives: both rounds alike at T = 0", "engine/lanes.py", "half = 0 if heat else r",
      "half = 0",
      "test_lives.py::test_lives_have_the_law_of_the_twin[uniform-0.0-soft-1.0]"),
    M("lives: clocks from the words of thresholds", "engine/lanes.py", "-log(uniform(words[2, i], words[3, i]))",
      "-log(uniform(words[0, i], words[1, i]))",
      "test_trajectory.py::test_agrees_with_steady"),
    M("lives: annealed clocks 1 % slow", "laws/barrier/pooled.py",
      "return min(xi, _inverse(law, clock *", "return min(xi, _inverse(law, 1.01 * clock *",
      "test_thermal.py::test_lives_spend_their_clocks"),
    M("lives: work of a spring", "laws/aging/base.py", "    return 0.5 * stiffness * x * x\n",
      "    return 0.501 * stiffness * x * x\n", "test_steady.py::test_zero_temperature[1.0]"),
    # paths
    M("paths: no repulsion in a passage", "engine/langevin.py", "* exp(swerve + pull)", "* exp(pull)",
      "test_aging_engine.py::test_the_drift_in_a_passage"),
    M("paths: no pull in a passage", "engine/langevin.py", "* exp(swerve + pull)", "* exp(swerve)",
      "test_aging_engine.py::test_the_drift_in_a_passage"),
    M("paths: steps ignore the drift", "engine/langevin.py",
      "speed = abs(c.moves) + max(0.0, drift)", "speed = 1.0",
      "test_aging_engine.py::test_steps_keep_their_distance"),
    M("paths: no passage within a step", "engine/langevin.py", "return passage * (1.0 - zero) <",
      "return passage * (1.0 - zero) < 0.0 *", "test_aging_engine.py::test_the_drift_in_a_passage"),
    M("paths: half-way spread", "engine/langevin.py", "spread2 = 0.5 * c.aging.final2 * lost / (1.0 + kept)",
      "spread2 = 0.5 * c.aging.final2 * lost", "test_aging_engine.py::test_halfway_of_a_step"),
    M("paths: chi-square of small shapes", "engine/deviates.py", "return 2.0 * third * cube * lift if taken",
      "return 2.0 * third * cube if taken", "test_aging_engine.py::test_deviates_of_a_step[0.3]"),
    M("paths: the fourth uniform left out", "engine/deviates.py", "return product * e if count > 3 else product",
      "return product", "test_aging_engine.py::test_deviates_of_a_step[6.0]"),
    M("paths: spread of a step", "engine/langevin.py", "s2 = 0.5 * c.aging.final2 * lost * (2.0 - lost)",
      "s2 = 0.5 * c.aging.final2 * lost", "test_aging_engine.py::test_lives_of_fluctuating_thresholds[path3]"),
    M("paths: time of a passage, other root", "engine/langevin.py", "if d > mean / (mean + ratio):",
      "if d < mean / (mean + ratio):", "test_aging_engine.py::test_when_a_passage_comes"),
    M("paths: hazards of a step do not scatter", "engine/langevin.py", "scatter = scatter if scatter < 1.0 else 0.0",
      "scatter = 0.0", "test_aging_engine.py::test_clocks_that_stop_within_a_step"),
    M("paths: work by the force at the ends", "engine/langevin.py",
      "return slid * (k0 * x + 4.0 * k01 * (x + 0.5 * slid) + k1 * (x + slid)) / 6.0",
      "return slid * (k0 * x + k1 * (x + slid)) / 2.0",
      "test_aging_engine.py::test_work_of_a_stiffness_that_fluctuates[path0]"),
    # recorder
    M("recorder: leave, square of the slope", "engine/recorder.py",
      "fixed(stiffness * stiffness, scales.slope2)", "fixed(stiffness, scales.slope2)",
      "test_ramps.py::test_single_deposits"),
    M("recorder: leave, ramp of the square", "engine/recorder.py",
      "fixed(stiffness * ramp, scales.ramp2)", "fixed(ramp, scales.ramp2)",
      "test_ramps.py::test_single_deposits"),
    M("recorder: deposit starts a point early", "engine/recorder.py",
      "start, end = point_at(recorder.run, ramp.born)",
      "start, end = max(0, point_at(recorder.run, ramp.born) - 1)",
      "test_ramps.py::test_single_deposits"),
    M("recorder: deposits that no point sees", "engine/recorder.py", "if start < end:  # otherwise",
      "if start <= end:  # otherwise", "", "what is left at a point is taken back at the same point"),
    M("recorder: record, area", "engine/recorder.py",
      "* (0.5 * (start + end) - life.origin)",
      "* (0.5 * (start + end))", "test_ramps.py::test_records_of_quarters"),
    M("recorder: record, quarters overlap", "engine/recorder.py",
      "high = low + 0.25 * length", "high = low + 0.26 * length",
      "test_ramps.py::test_records_of_quarters"),
    M("recorder: leave_ramps, ramp of the square", "engine/recorder.py",
      "fixed_narrow(kappa * (kappa * born[i]),", "fixed_narrow(kappa * born[i],",
      "test_ramps.py::test_deposits_side_by_side"),
    M("recorder: leave_ramps, square", "engine/recorder.py",
      "fixed_narrow(stretched * stretched,", "fixed_narrow(stretched,",
      "test_ramps.py::test_deposits_side_by_side"),
    M("recorder: join_ramps, square", "engine/recorder.py",
      "fixed_narrow(difference,", "fixed_narrow(difference - born[i],",
      "test_ramps.py::test_deposits_that_join"),
    M("recorder: few contacts count as many", "engine/recorder.py", "2 ** (_SUM_BITS - 51)", "2 ** (_SUM_BITS - 60)",
      "test_ramps.py::test_no_sum_can_overflow"),
    M("recorder: narrow numbers of no sign", "engine/recorder.py", "scale + 1.5 * 2.0**52)", "scale + 2.0**52)",
      "test_ramps.py::test_narrow_numbers_are_rounded_alike"),
    M("recorder: fields change places", "engine/recorder.py",
      "here.slope2 = slope2 + sign * added.slope2", "here.slope2 = slope2 + sign * added.slope",
      "test_ramps.py::test_deposits_side_by_side"),
    M("streams: halves apart", "numerics/streams.py",
      "upper -= 2.0**84 + 2.0**52", "upper -= 2.0**84",
      "test_elementary.py::test_uniforms_are_rounded_once"),
    M("recorder: first point after", "engine/recorder.py", "np.ceil(min(x[i] * per_step, float(run.points)))",
      "np.floor(min(x[i] * per_step, float(run.points)))", "test_ramps.py::test_deposits_side_by_side"),
    M("segments: leave_span, stiffness of birth", "engine/segments.py",
      "stiffness * growth(c.aging, span.age + elapsed) * x", "stiffness * x",
      "test_ramps.py::test_forces_that_are_no_ramps"),
    M("segments: leave_span, work since birth", "engine/segments.py",
      "fixed(until - before,", "fixed(until,",
      "test_ramps.py::test_forces_that_are_no_ramps"),
    M("recorder: leave_force, a square that stays", "engine/recorder.py",
      "    after.square -= fixed(force * force, scales.square)\n", "",
      "test_ramps.py::test_forces_that_are_no_ramps"),
    M("segments: leave_stiffening_path, the last quarter", "engine/segments.py",
      "2 < window < 5:", "2 < window < 4:",
      "test_aging_engine.py::test_stationary_start[langevin sqrt]"),
    M("segments: leave_stiffening_path, force at birth", "engine/segments.py",
      "kappa(laws.springs, path.xi) * path.x)\n            j += 1",
      "kappa(laws.springs, 1.0) * path.x)\n            j += 1",
      "test_aging_engine.py::test_fresh_start[langevin sqrt]"),
    M("segments: stationary paths, cycles too short", "engine/segments.py",
      "longest = recorder.start.longest + delay", "longest = recorder.start.longest",
      "test_aging_engine.py::test_delays_longer_than_any_life_in_a_stationary_start"),
    M("segments: stationary paths, rest of a delay", "engine/segments.py",
      "else ends + delay\n", "else delay\n",
      "test_aging_engine.py::test_delays_longer_than_any_life_in_a_stationary_start"),
    M("stationary: whole delays", "engine/stationary.py",
      "return seen_detached(residual_delay_draw(c.delay, u_rest))",
      "return seen_detached(c.delay.mean)",
      "test_trajectory.py::test_a_stationary_start_stays_level"),
    M("segments: lives one by one, third quarter lost", "engine/segments.py",
      "reborn > 0.5 * run.length:", "reborn > 0.75 * run.length:",
      "test_lives.py::test_side_by_side_as_one_by_one"),
    M("recorder: edge of the third quarter", "engine/recorder.py",
      "x <= 0.75 * run.length:\n        return (0.5 if x <= 0.5 * run.length else "
      "0.75) * run.length",
      "x <= 0.7 * run.length:\n        return (0.5 if x <= 0.5 * run.length else 0.7) "
      "* run.length", "test_ramps.py::test_edges"),
    M("segments: crossing an edge, quarters exchanged", "engine/segments.py",
      "0 if edge[i] < run.length else 1", "1 if edge[i] < run.length else 0",
      "test_ramps.py::test_crossing_an_edge"),
    M("segments: crossing an edge, delays count as stretch", "engine/segments.py",
      "fixed(pinned, scales.stretch)", "fixed(elapsed, scales.stretch)",
      "test_ramps.py::test_crossing_an_edge"),
    M("segments: a last life counts twice", "engine/segments.py",
      "work = averaging.work[i] - 0.5 * stiffness * x * x", "work = averaging.work[i]",
      "test_lives.py::test_side_by_side_as_one_by_one"),
    M("segments: pinned to rounding", "engine/segments.py",
      "averaging.pinned[i] - x if delayed else elapsed", "averaging.pinned[i] - x",
      "test_trajectory.py::test_without_delay_the_pinned_fraction_is_exact"),
    M("segments: lives not counted", "engine/segments.py",
      "+= number + 1 - averaging.lives[i]", "+= number - averaging.lives[i]",
      "test_lives.py::test_side_by_side_as_one_by_one"),
    M("lanes: ages forgotten in a move", "engine/lanes.py",
      "age[i] = age[active]", "age[i] = age[i]",
      "test_lives.py::test_side_by_side_as_one_by_one"),
    M("recorder: moments, drag has no variance", "engine/recorder.py", "square + drag**2 * (1.0 - pinned) - force**2",
      "square - force**2 * (drag >= 0.0)", "test_trajectory.py::test_strong_drag_between_replicas & "
      "test_trajectory.py::test_stationary_start_and_fluctuations[fixed]"),
    M("recorder: force of a replica without drag", "engine/recorder.py", "mean += drag * (1.0 - pinned)", "pass",
      "test_trajectory.py::test_strong_drag_between_replicas"),
    M("recorder: moments, ramps of squares once", "engine/recorder.py",
      "2.0 * ramp2) * X", "ramp2) * X",
      "test_trajectory.py::test_stationary_start_and_fluctuations[fixed]"),
    M("recorder: sums may overflow", "engine/recorder.py", "_BITS = 62", "_BITS = 70",
      "test_ramps.py::test_no_sum_can_overflow"),
    # stationary
    M("stationary start: no longest stretches", "engine/stationary.py", "plateau = 1.0 / (1.0 + math.log(top / m))",
      "plateau = 1.02 / (1.0 + math.log(top / m))",
      "test_trajectory.py::test_a_snapshot_of_the_stationary_state[ensemble0]"),
    M("stationary start: envelope 20 % low", "engine/stationary.py", "_MARGIN = 1.0 + 1e-4", "_MARGIN = 0.8",
      "test_trajectory.py::test_a_snapshot_of_the_stationary_state"),
    M("stationary start: thresholds of births", "engine/stationary.py", "time = means * births_per_log(",
      "time = births_per_log(", "test_trajectory.py::test_a_snapshot_of_the_stationary_state"),
    M("stationary start: shares of births of a table", "engine/stationary.py", "np.cumsum(means) / means.sum()",
      "np.arange(1, means.size + 1) / means.size", "test_trajectory.py::test_a_snapshot_of_the_stationary_state"),
    M("stationary start: lives that reach the threshold", "engine/stationary.py",
      "return total + np.where(last < top, ends, stretch) * np.exp(-np.exp(last))", "return total",
      "test_trajectory.py::test_a_snapshot_of_the_stationary_state"),
    M("stationary start: longest life too short", "engine/stationary.py", "1e-5 * (weight @ stretch)",
      "1e-2 * (weight @ stretch)", "test_aging_engine.py::test_the_longest_life_of_a_stationary_start"),
    # steady
    M("steady: the same draws for all parameter sets", "engine/steady.py", "proposal, identity, seed",
      "proposal, 7, seed", "test_steady.py::test_parameter_sets_at_one_seed_are_independent"),
    M("steady: few thresholds hide nothing", "engine/errorbars.py", "max(3.0 * float(np.ptp(x)",
      "max(0.03 * float(np.ptp(x)", "test_steady.py::test_two_thresholds_without_heat"),
    M("steady: rare clocks hide nothing", "engine/errorbars.py", "errors.append(float(change.sum(axis=0)[1:]",
      "errors.append(0.0 * float(change.sum(axis=0)[1:]", "test_steady.py::test_rare_clocks"),
    M("steady: scatter over R, not R - 1", "engine/steady.py", "np.std(residual, ddof=1)", "np.std(residual, ddof=0)",
      "test_steady.py::test_averages_of_known_sums"),
    M("steady: cycles without their delay", "engine/steady.py",
      "(work + drag * delay - friction * cycle) / cycle.mean()",
      "(work + drag * delay - friction * travel) / cycle.mean()", "",
      "what is left out is the same for all randomisations and changes no standard deviation"),
    M("steady: pinned fraction without its cycle", "engine/steady.py", "(travel - pinned * cycle) / cycle.mean()",
      "travel / cycle.mean()", "test_steady.py::test_averages_of_known_sums"),
    M("steady: largest share of a life unheeded", "engine/steady.py", "covered and float(sums[:, 4].max()) < _DOMINANT",
      "covered", "test_steady.py::test_heavy_tails_need_the_proposal"),
    M("steady: rare thresholds unheeded", "engine/proposal.py",
      "covered = bool(density[-1] < _NEGLIGIBLE_DENSITY * density.max())", "covered = True",
      "test_steady.py::test_a_law_without_an_end_is_unreliable"),
    M("steady: error of C unseen", "engine/steady.py", "    rows[:, :4] += shift[:, None] * response[:4]\n", "",
      "test_steady.py::test_every_randomisation_has_its_own_fixed_point"),
    M("steady: weights of the clock left out", "engine/randomise.py", "weight[i] * clock_weight[i]", "weight[i]",
      "test_steady.py::test_heavy_tails"),
    # births
    M("newborn: thresholds that do not know that they hold", "laws/newborn.py", "threshold_at(thresholds, e - log(u))",
      "look_up(thresholds.table, -log(u))", "test_newborn.py::test_births"),
    M("programme: small differences of ln z not told apart", "master/fronts.py",
      "    if excess <= 0.0:", "    if excess <= 1.0:",
      "test_fronts.py::test_share_of_small_differences"),
    M("programme: the youngest contacts too strong", "master/fronts.py",
      "if power < 2.0:", "if power < 0.0:",
      "test_programme_reference.py::test_lives_far_shorter_than_steps"),
    M("programme: births of a step are 700 at most", "master/fronts.py",
      "ages_of_survivors(z[k]), ages", "ages_of_survivors(min(z[k], 700.0)), ages",
      "test_programme_reference.py::test_lives_far_shorter_than_steps"),
    M("programme: contacts weaker than a step live without heat", "master/fronts.py",
      "min(xm, passed)", "min(xm, xi * gm)",
      "test_programme_reference.py::test_lives_far_shorter_than_steps"),
    M("programme: thresholds beyond 8.2 deviates never matter", "master/programme.py",
      "- max(contacts.barrier.log_w, 0.0)", "",
      "test_programme_reference.py::test_lives_far_shorter_than_steps"),
    M("programme: survivors of births half way between thresholds", "master/fronts.py",
      "if apart < _LEAST_DIFFERENCE:", "if True:",
      "test_fronts.py::test_survivors_across_a_stratum"),
    M("newborn: sign of a fraction", "laws/newborn.py", "return xi, xi * y", "return xi, xi * abs(y)",
      "test_newborn.py::test_fractions_and_steps"),
    M("barrier: births against the motion safe", "laws/barrier/base.py",
      "s, clock = back(c.barrier, c, xi, k, -y, clock)", "s, clock = -y, clock",
      "test_newborn.py::test_travel"),
    M("segments: births forgotten in the force", "engine/segments.py",
      "origin = begins - span.stretch if", "origin = begins if",
      "test_newborn.py::test_runs"),
    # programmes
    M("programme: hazard forgets the sign", "laws/aging/base.py",
      "return (before + hazard(", "return (-before + hazard(", "test_programme.py::test_clocks_along_a_segment"),
    M("programme: a hold breaks nothing", "laws/aging/base.py", "xi, stiffness, y, way) * length",
      "xi, stiffness, y, way) * way", "test_programme.py::test_agrees_with_the_renewal_equation"),
    M("standstill: from the difference of two stretches", "laws/aging/base.py",
      "    if y < 0.0 < end:", "    length = (end - y) / moves if moves else length\n    if y < 0.0 < end:",
      "test_standstill.py::test_slow_motion_meets_the_hold"),
    M("standstill: pooled rates of one node", "laws/barrier/pooled.py", "if length < _POINT * x or length == 0.0:",
      "if length < 1e-3 * x:", "test_standstill.py::test_pieces_add_up[annealed table]"),
    M("standstill: paths in cells that their stretch resolves", "laws/aging/along.py", "last = level >= _DEEPEST",
      "last = level >= _DEEPEST or x1 - x0 <= 4e-16 * (x1 + abs(c.stretch))",
      "test_standstill.py::test_ages_below_the_resolution_of_the_stretch"),
    M("standstill: crossings to a unit of the stretch", "laws/aging/along.py",
      "<= 2e-16 * bracket.high",
      "<= 2e-16 * (abs(contact.stretch) + bracket.high)",
      "test_standstill.py::test_slow_falls_cross_when_they_do"),
    M("standstill: where an earlier segment would have broken it", "engine/programme.py",
      "bool(before) and index == 0 and (leg.pace", "bool(before) and index != 1 and (leg.pace",
      "test_standstill.py::test_parts_of_a_segment_are_the_segment"),
    M("standstill: instants that take time", "engine/slider.py", "_SLIP_DURATION = 1e-40", "_SLIP_DURATION = 1e-12",
      "test_standstill.py::test_a_slow_stage_takes_no_time_to_slip"),
    M("lives: holds without end", "engine/programme.py", "waits_at_rest(c, leg.length)", "waits_at_rest(c, math.inf)",
      "test_standstill.py::test_lives_of_holds_are_predicted"),
    M("programme: clocks of the way back", "laws/aging/base.py", "travel(c, xi, stiffness, y, moves",
      "travel(c, xi, stiffness, abs(y), moves", "test_programme.py::test_clocks_along_a_segment"),
    M("programme: a stationary start goes on at any velocity", "engine/programme.py",
      "index == 0 and (leg.pace, leg.sign) == (pace, 1)", "index == 0 and leg.sign == 1",
      "test_programme.py::test_agrees_with_the_renewal_equation"),
    M("programme: no reversal of stretches", "engine/segments.py",
      "y, age = run.sign * p.stretch[i],", "y, age = p.stretch[i],",
      "test_programme.py::test_agrees_with_the_renewal_equation"),
    M("programme: no age in segments", "engine/segments.py",
      "p.age[i] = age + run.length", "p.age[i] = age",
      "test_programme.py::test_agrees_with_the_renewal_equation"),
    M("programme: clocks begin anew", "engine/segments.py", "    p.clock[i] = left\n",
      "", "test_programme.py::test_agrees_with_the_renewal_equation"),
    M("programme: delays at the pace before", "engine/segments.py",
      "reborn = p.lives[i] // ROUNDS, p.wait[i] * run.ratio",
      "reborn = p.lives[i] // ROUNDS, p.wait[i]",
      "test_programme.py::test_agrees_with_the_renewal_equation"),
    M("programme: falling thresholds met on the way back", "laws/aging/along.py",
      "if turn > 0.0 and growth(law, age + turn) < growth(law, age):", "if False:",
      "test_programme.py::test_first_crossing"),
    M("programme: no error for what was not met", "engine/programme.py", "lives=float(count),", "lives=math.inf,",
      "test_programme.py::test_few_contacts_quote_what_they_did_not_meet"),
    M("programme: extrapolated as of first order", "master/programme.py", "extrapolated(coarse, fine[:, ::2])",
      "2 * fine[:, ::2] - coarse", "test_programme_reference.py::test_force_in_a_hold"),
    M("programme: rates between thresholds are on a line", "master/programme.py",
      "for _ in range(_MOST_HALVINGS):", "for _ in range(0):",
      "test_programme_reference.py::test_heat_breaks_contacts_far_from_any_threshold"),
    M("programme: only rates in the middle of a cell matter", "master/programme.py",
      "np.exp(np.minimum(fastest, 0.0)) * left[1]", "np.exp(np.minimum(exact, 0.0)) * middle[1]",
      "test_programme_reference.py::test_heat_breaks_contacts_far_from_any_threshold"),
    M("programme: steps end where nothing is sharp", "master/programme.py", "for s in sharp], atoms - instant",
      "for s in sharp[:0]], atoms[:0]",
      "test_lattice.py::test_steps_end_where_the_density_jumps"),
    M("slider: a step may miss any force", "master/slider.py", "not (spring.heat or given) and off >",
      "False and off >", "test_lattice.py::test_behind_a_stage"),
    M("programme: peaks of steps both ways", "engine/readings.py",
      "direction * (force - force[0]) if direction else np.abs(force - force[0])", "np.abs(force - force[0])",
      "test_protocols.py::test_effects_of_velocity_steps"),
    M("programme: peaks as they come", "engine/readings.py", "best, place = float(c - 0.25 * b * b / a),",
      "best, place = best,", "test_protocols.py::test_peaks_of_noise_are_not_too_high"),
    # trajectory
    M("trajectory: replicas over R, not R - 1", "engine/blocks.py", "np.maximum(spread, 0.0) / (replicas - 1)",
      "np.maximum(spread, 0.0) / replicas", "test_trajectory.py::test_standard_deviation_of_few_replicas"),
    M("scatter: paths know how rare breaks are", "engine/scatter.py", " + contacts / law.lives", "",
      "test_scatter.py::test_rare_breaks_of_fluctuating_thresholds"),
    M("scatter: paths meet what there is", "engine/scatter.py", "if law.lives == math.inf:", "if True:",
      "test_scatter.py::test_rare_breaks_of_fluctuating_thresholds"),
    M("scatter: contacts born once", "engine/scatter.py", "found[k] * later", "0.0 * later",
      "test_scatter.py"),
    M("scatter: nobody unmet", "engine/scatter.py", " + unmet / contacts) / contacts", ") / contacts",
      "test_scatter.py"),
    M("scatter: no drag", "engine/scatter.py", "powers = drag **", "powers = (0.0 * drag) **",
      "test_scatter.py"),
    M("scatter: skewed averages are normal", "engine/scatter.py", "ENOUGH = 100 ", "ENOUGH = 1 ", "test_scatter.py"),
    M("trajectory: no rare deviations", "engine/scatter.py", "RARE = 1e-4", "RARE = 2.0",
      "test_scatter.py & test_cli.py::test_error_bars_that_cannot_be_trusted_say_so"),
    M("trajectory: transients over too early", "engine/trajectory.py", "0.5 * (average", "50.0 * (average",
      "test_scatter.py & test_trajectory.py"),
    M("trajectory: scatter of a fresh start", "engine/trajectory.py", "None if run.stationary else run.distance",
      "run.distance", "test_scatter.py & test_trajectory.py"),
    M("transient: no cell with negative breaks", "master/transient.py", "per_length = back(breaks) / h",
      "per_length = np.maximum(back(breaks), 0.0) / h",
      "test_validation.py::test_squares_of_laws_that_begin_with_a_jump"),
    M("validation: variances of a few broken contacts", "validation/scores.py",
      "enough = min(few, broken) >= _ENOUGH_SQUARES", "enough = few >= _ENOUGH_SQUARES",
      "test_validation.py::test_variances_of_a_few_broken_contacts_are_not_scored"),
    M("trajectory: drifts of 40 errors", "engine/trajectory.py", "sigmas=4.0)", "sigmas=40.0)",
      "test_trajectory.py::test_a_drift_of_some_errors_is_seen"),
    M("trajectory: lives longer than the run", "engine/trajectory.py", "np.minimum(stretch + c.delay.mean, distance)",
      "stretch + c.delay.mean", "test_trajectory.py::test_predicted_lives_of_heavy_tails"),
    M("trajectory: drag while pinned", "engine/trajectory.py", "over(area + drag * (elapsed - pinned), elapsed)",
      "over(area + drag * elapsed, elapsed)", "test_trajectory.py::test_agrees_with_steady"),
    # estimate
    M("estimate: error of a ratio without B/(B - 1)", "estimate.py", "batches / (batches - 1) *", "1.0 *",
      "test_steady.py::test_error_of_a_ratio"),
    M("estimate: halves of a drift over B", "estimate.py", "np.var(residual, ddof=1)", "np.var(residual, ddof=0)",
      "test_steady.py::test_halves_that_differ_drift"),
    M("estimate: drifts upward only", "estimate.py", "bool(abs(ratios[1] - ratios[0])", "bool((ratios[1] - ratios[0])",
      "test_steady.py::test_halves_that_differ_drift"),
    M("estimate: scores without Student", "estimate.py", "special.stdtr(estimate.dof, -abs(z))",
      "special.ndtr(-abs(z))", "test_steady.py::test_student_scores"),
    M("estimate: sign of a difference", "estimate.py", "return (first.value - second.value) / sigma",
      "return (second.value - first.value) / sigma", "test_steady.py::test_difference_of_estimates"),
    # model
    M("model: drag without the stiffness", "model/reduced.py", "ensemble.eta / ensemble.mean_stiffness * velocity",
      "ensemble.eta * velocity", "test_steady.py::test_viscosity_and_delay"),
    M("model: sqrt law by the mean threshold", "model/reduced.py", "Springs(0.0, self.law.scale / self.law.rms)",
      "Springs(0.0, self.law.scale / self.law.mean)", "test_steady.py::test_zero_temperature[1.0]"),
    M("model: final law by its root", "laws/aging/flow.py", "aging.final(law.x_star) ** 2, aging.alpha",
      "aging.final(law.x_star), aging.alpha", "test_aging.py::test_reduced"),
    M("model: b by a half", "laws/barrier/base.py", "energy, kT = 0.5 * stiffness", "energy, kT = 0.25 * stiffness",
      "test_thermal.py::test_crossover_velocity_is_nt12"),
    M("model: distance of 100 thresholds", "model/drive.py", "return 200.0 * max(",
      "return 100.0 * max(", "test_runfile.py::test_defaults"),
    M("populations: every kind by its number", "model/mixture.py", '"friction": "weight"', '"friction": "share"',
      "test_populations.py::test_two_thresholds_in_closed_form"),
    M("populations: a travel that lowers no share of breaks", "model/mixture.py",
      "travels - rate * (value - mean)", "travels + 0.0 * value", "test_populations.py::test_steady_averages"),
    M("populations: the same random numbers for all", "model/ensemble.py",
      "seed_named(seed, self.number) if self.number else seed", "seed",
      "test_populations.py::test_identical_populations_are_independent"),
    M("populations: smallest remainders", "model/ensemble.py", "numbers[i] - exact[i]", "exact[i] - numbers[i]",
      "test_populations.py::test_contacts_are_divided_by_largest_remainders"),
    M("populations: a mean field of forces by number", "master/cohorts.py", "kinds.weight * kinds.unit * kinds.history",
      "kinds.share * kinds.unit * kinds.history",
      "test_populations.py::test_the_mean_field_behind_a_stiff_spring_is_a_rigid_mixture"),
    M("populations: a mean field in units of the ensemble", "master/cohorts.py", "X[m] = X / kinds.unit", "X[m] = X",
      "test_populations.py::test_the_mean_field_behind_a_stiff_spring_is_a_rigid_mixture"),
    M("slider: kinds in units of the ensemble", "engine/slider.py", "piece.duration / x.unit", "piece.duration",
      "test_populations.py::test_a_stage_pulls_identical_populations_as_one"),
    # fits
    M("profiles: level of 95 % for one side", "fitting/profiles.py", '"95": 3.8415', '"95": 2.7055',
      "test_fit.py::test_levels"),
    M("fluctuations: stretched births as if unstretched", "master/transient.py", "if s.newborn.active:", "if False:",
      "test_newborn_reference.py::test_autocovariance_from_lag_0_on"),
    M("fronts: no error of steps where coarse ones have no front", "engine/chain_records.py",
      'if coarse["speed"].size else 0.0', 'if coarse["speed"].size else float(np.mean(speed))',
      "test_chain.py::test_errors_of_fronts_hold_those_of_steps"),
    M("programmes: cohorts of a stationary start as wide as steps", "master/programme.py",
      "_WIDTH_PER_LIFE * short", "width",
      "test_programme_reference.py::test_stationary_starts_of_contacts_that_hardly_move"),
    M("programmes: lives that cohorts do not resolve", "master/programme.py", "first, first <= short)", "first, True)",
      "test_programme_reference.py::test_stationary_starts_of_contacts_that_hardly_move"),
    M("stationary: discrete lives, but for the longest", "engine/stationary.py",
      "max(1.1 * float(stretch[found]), float(stretch[max(found - 1, 0)]))", "1.1 * float(stretch[found])",
      "test_newborn_reference.py::test_autocovariance_from_lag_0_on"),
    M("profiles: predictions fall where residuals do", "fitting/profiles.py",
      "slopes = -problem.unitless", "slopes = problem.unitless",
      "test_fit.py::test_profiles_move_other_parameters_off_their_bounds"),
    M("fits: a robust search ends far from the data", "fitting/estimate.py",
      "return min(best, again, key=lambda end: end.chi2)._replace(solves=solves)", "return best",
      "test_fit.py::test_a_start_many_standard_errors_away"),
    M("fits: data far below a fit are impossible", "fitting/fit.py",
      "stats.norm.isf(stats.t.sf(np.abs(r), STUDENT))", "stats.norm.isf(stats.t.sf(r, STUDENT))",
      "test_fit.py::test_residuals_of_either_sign"),
    M("fits: contacts as stiff as those of the run file", "fitting/fit.py",
      "dict(row.changes).get(k, file[k]) for row", "file[k] for row",
      "test_fit.py::test_the_standard_deviation_of_the_force_of_each_stiffness"),
    M("fits: a model is compared at the temperatures of another", "fitting/fit.py",
      "heat=one.kelvin / unit", "heat=one.heat", "test_fit.py::test_compared_at_the_same_temperatures"),
    M("profiles: old derivatives of a robust loss", "fitting/estimate.py",
      'converged = fresh or problem.loss == "gaussian"', "converged = True",
      "test_fit.py::test_chi_square_at_the_ends_of_intervals"),
    M("profiles: searches in the units of linear keys", "fitting/estimate.py",
      "self.unit = problem.unit_of_variables[self.index]", "self.unit = np.ones(self.index.size)",
      "test_fit.py::test_intervals_in_any_unit"),
    M("fits: one key that data do not tell takes the error of all", "fitting/estimate.py",
      "np.where(lost | lost[:, None],", "np.where(lost.any(),",
      "test_fit.py::test_covariance_of_keys_that_only_their_product_tells"),
    M("fits: directions that count in one unit of force alone", "fitting/estimate.py",
      "norm[norm == 0.0] = 1.0", "norm[:] = 1.0", "test_fit.py::test_bands_in_any_unit"),
    M("fits: squares of errors not relative to the force", "fitting/data.py",
      "math.hypot(noise.relative * value, noise.absolute)", "math.hypot(noise.relative, noise.absolute)",
      "test_fit.py::test_errors_of_measurements"),
    M("fits: whitened residuals of another variance", "fitting/model.py", "/ np.sqrt(1.0 - rho**2)", "/ (1.0 - rho**2)",
      "test_record.py::test_whitened_errors_are_independent"),
    M("symmetries: stiffness by one power of the length", "fitting/symmetry.py", "return length + time - force, force",
      "return length + time, force", "test_fit.py::test_symmetries_leave_every_prediction"),
    # delays and drag
    M("delay: births by a law less those of the step", "master/cohorts.py",
      "return tau * (due + rate * newer), later", "return tau * (due + rate * newer), 0.0",
      "test_delay_laws.py::test_pinned_share_of_contacts_with_a_constant_rate"),
    M("delay: the rest of a delay without its mean", "laws/delay.py",
      "return law.mean * max(x - (begun_at", "return max(x - (begun_at",
      "test_delay_laws.py::test_draws"),
    M("delay: a law tabulated without its mean", "laws/delay.py",
      "return law.mean * look_up(law.quantile, -log(u))", "return look_up(law.quantile, -log(u))",
      "test_delay_laws.py::test_draws"),
    M("delay: activation the wrong way", "laws/delay.py",
      "math.exp(self.activation / kT)", "math.exp(-self.activation / kT)",
      "test_delay_laws.py::test_activation"),
    M("delay: without end it ends with the step", "master/cohorts.py",
      "        later = 0.0\n", "        later = dt\n",
      "test_no_reattachment.py::test_a_programme"),
    M("bundle: a break leaves the stiffness", "engine/avalanches.py",
      "        now.stiffness -= stiffness * each\n", "        now.stiffness -= 0.0\n",
      "test_no_reattachment.py::test_a_quasi_static_stage"),
    M("drag: no constant force", "model/reduced.py",
      "drag += law.force / ensemble.mean_stiffness / unit", "drag += 0.0",
      "test_viscosity.py::test_steady_friction"),
    # master
    M("master: drag of the pinned", "master/steady.py", "elastic + drag * detached",
      "elastic + drag * pinned",
      "test_reference.py::test_transients_end_in_the_steady_state[ensemble2-0.05]"),
    M("many velocities: work of the sqrt law without later panels", "master/annealed.py",
      "stiff = (x * J + within) / self.contacts.rms", "stiff = x * J / self.contacts.rms",
      "test_velocities.py::test_single_solves"),
    M("many velocities: polynomial of x_*, not its square", "master/annealed.py", "t = (2.0 * log_square",
      "t = (log_square", "test_velocities.py::test_annealed_contacts_that_age"),
    M("master: error of C unheeded", "master/annealed.py", "grown * error)",
      "0.0 * error)", "test_reference.py::test_errors_of_self_consistent_births"),
    M("master: quenched, uniform work", "master/quenched.py", "lives *= kappa ** np.arange(powers)[:, None, None]",
      "lives *= 1.0", "test_reference.py::test_zero_temperature[1.0]"),
    M("master: quenched, work at T = 0", "master/quenched.py", "xi ** (power + 1) / (power + 1)",
      "xi ** (power + 1) / (power + 0.9)", "test_reference.py::test_zero_temperature[1.0]"),
    M("master: annealed, stiffness of survivors", "master/annealed.py", "later[:, :, None] - heavy @ rule.cumulative",
      "0.0 * later[:, :, None]", "test_reference.py::test_table[public-024]"),
    M("master: survivors of growing thresholds, hazard", "master/flow.py",
      "found[part] = per_u @", "found[part] = 0.99 * per_u @",
      "test_logarithmic.py::test_slow_growth_is_none"),
    M("model: streams do not know t_c", "laws/aging/__init__.py",
      "return self.beta, self.cutoff_time * velocity / unit", "return (self.beta,)",
      "test_logarithmic.py::test_numbers"),
    M("master: flow, stiffness of birth", "master/flow.py",
      "return kappa_of(contacts, xi if contacts.aging.stiffens else xi0)", "return kappa_of(contacts, xi0)",
      "test_flow.py::test_single_contacts"),
    M("master: Fokker-Planck, repulsion", "master/fokker_planck.py", "spread * ((2 * self.n + 1) / eta - 2.0 * eta)",
      "spread * ((2 * self.n) / eta - 2.0 * eta)", "test_fokker_planck.py::test_table[public-028]"),
    M("master: Fokker-Planck, rate without its threshold", "master/fokker_planck.py", "xi = x + s * grid.y\n",
      "xi = x + grid.y\n", "test_fokker_planck.py::test_table[public-028]"),
    M("delay: exponential ones in cells", "laws/delay.py", "self.mean * np.arange(cells))",
      "self.mean * (np.arange(cells) + 1))", "test_reference.py::test_transient_at_zero_temperature"),
    M("master: breaks of a stationary start", "master/transient.py",
      "pinned / known(exact.travel) * level", "1.0 / known(exact.travel) * level",
      "test_reference.py::test_a_stationary_start_is_level"),
    M("master: fluctuations about 0", "master/transient.py", "back + waiting - mean**2)", "back + waiting)",
      "test_reference.py::test_fluctuations"),
    M("master: fluctuations, residual of a fixed delay", "master/transient.py", "(total(x) - late) / delay",
      "late / delay", "test_reference.py::test_fluctuations[fixed]"),
    M("master: closure, births of a cell", "master/closure.py", "moment = np.where(small, 0.5 - z / 3",
      "moment = np.where(small, 0.6 - z / 3", "test_closure.py::test_without_aging"),
    M("master: densities, thermal rate", "master/curves.py", "found.reshape(u.shape) / s.law.scale)",
      "found.reshape(u.shape))", "test_densities.py::test_closed_forms"),
    M("variances: tails end at e = 500", "laws/threshold.py", "np.where(lost, math.inf, total + rest)",
      "np.where(lost, math.inf, total)", "test_variance.py::test_closed_forms[pareto 3.05-uniform]"),
    M("variances: a divergent mean square is finite", "laws/threshold.py", ">= 1.0 - _LEAST_DECAY", ">= 2.0",
      "test_variance.py::test_where_a_variance_ends"),
    M("variances: no lives are drawn for the mean square", "engine/proposal.py",
      "(stretched or source.unmet(fewest) > _UNMET_SQUARES)", "stretched",
      "test_variance.py::test_steady_over_seeds[pareto 5.6]"),
    M("variances: what lies beyond the last threshold is not an error", "engine/errorbars.py",
      "return proposal.squares.beyond", "return 0.0",
      "test_variance.py::test_steady_where_thresholds_end_too_early"),
    M("variances: the covariance ends with the profile of a life", "master/transient.py",
      "total = beyond + [", "total = 0.0 * beyond + [",
      "test_variance.py::test_covariance_at_no_lag[pareto 3.05-uniform]"),
    M("master: variance without its births", "master/transient.py", "(first + later", "(first",
      "test_reference.py::test_variance_at_rest[ensemble0-0.1]"),
    M("laws: equal numbers of different laws", "laws/law.py", "type(self) is type(other) and tuple", "tuple",
      "test_fokker_planck.py::test_laws_with_equal_numbers"),
    M("master: panels at 0 like others", "numerics/panels.py",
      "np.where(left == 0, first, pieces)", "np.where(left == 0, pieces, pieces)", "test_panels.py::test_pieces"),
    M("model: a velocity is a drive", "model/drive.py", "if not isinstance(drive, Drive):", "if drive is None:",
      "test_reference.py::test_what_is_no_drive_is_refused"),
    M("published: S_1", "master/closed_forms.py", "return C_0 / 2 * (1 + self.b)", "return C_0 * (1 + self.b)",
      "test_asymptotics.py::test_closed_forms"),
    M("published: C_12 as printed", "master/closed_forms.py", "1.324 if printed", "1.342 if printed",
      "test_asymptotics.py::test_printed_coefficients"),
    M("published: C~_12 as printed", "master/closed_forms.py", "1.789 if printed", "1.798 if printed",
      "test_asymptotics.py::test_printed_coefficients"),
    M("published: C_2 as printed", "master/closed_forms.py", "16 / (9 * math.pi) - 1 / 3",
      "16 / (9 * math.pi) - 1 / 2", "test_asymptotics.py::test_printed_coefficients"),
    M("published: C_12 corrected", "master/closed_forms.py", "else 3 * math.sqrt(math.pi) / 8",
      "else 3.01 * math.sqrt(math.pi) / 8", "test_asymptotics.py::test_aging_coefficients"),
    M("published: star3a", "master/closed_forms.py", "power = u if printed else u**3", "power = u if printed else u**2",
      "test_asymptotics.py::test_aging_changes_the_law"),
    # materials
    M("materials: values in other units", "materials.py", "Parameter(name, value, unit,",
      "Parameter(name, 1e-3 * value, unit,", "test_materials.py::test_parameters"),
    M("materials: a unit", "materials.py", "value, unit, meaning.format", 'value, "um", meaning.format',
      "test_materials.py::test_parameters"),
    M("materials: attempt frequency", "materials.py", "return 1.76 * math.sqrt", "return 1.67 * math.sqrt",
      "test_materials.py::test_printed_numbers"),
    M("materials: rates that cold makes fast", "materials.py", "math.exp(-self._exponent(temperature))",
      "math.exp(-0.5 * self._exponent(temperature))", "test_materials.py::test_arrhenius"),
    # validation
    M("slider: contacts age no more", "engine/slider.py",
      "    contact.time_since_birth += left\n", "",
      "test_slider.py::test_thresholds_grow_behind_a_stiff_spring"),
    M("slider: breaks soften nothing", "engine/slider.py", "return -self.by_motion / max", "return 0.0 / max",
      "test_slider.py::test_agrees_with_small_steps"),
    M("slider: stretches at breaking of before", "engine/slider.py", "x = y + piece.speed * broke", "x = y",
      "test_slider.py::test_energy_and_threads"),
    M("slider: delays end at once", "engine/slider.py", "= delay_of(laws, key, number, contact)", "= 0.0",
      "test_slider.py::test_agrees_with_small_steps"),
    M("slider: every block has the contacts of the first", "engine/slider.py",
      "_follow_contact(laws, piece, key, first + i,",
      "_follow_contact(laws, piece, key, first + i - begin,",
      "test_slider.py::test_a_stiff_spring_is_a_rigid_slider"),
    M("slider: hazard of short pieces", "laws/barrier/soft.py", "(1.0 / 3.0 + p2 * (0.1", "(1.0 / 3.0 + p2 * (0.2",
      "test_thermal.py::test_mean_rate_between_two_stretches"),
    M("slider: mean field without damping", "master/slider.py", "stage.damping / time,", "0.5 * stage.damping / time,",
      "test_slider.py::test_mean_field_positions"),
    M("avalanches: a heap out of order", "engine/avalanches.py", "if child + 1 < n and", "if child + 1 < 0 and",
      "test_slider.py::test_avalanches_one_by_one"),
    M("events: too many candidates break", "engine/events.py", "unit * bound < actual", "unit * bound < 1.1 * actual",
      "test_events.py::test_mean_life_of_bonds"),
    M("events: force kept by broken contacts", "engine/events.py", "now.force -= stiffness * contact.stretch",
      "now.force -= 0.99 * stiffness * contact.stretch", "test_events.py::test_mean_life_of_bonds"),
    M("events: a substrate as if it were rigid", "engine/events.py", "damping *= 1.0 + now.stiffness / drive.stiffness",
      "damping *= 1.0", "test_events.py::test_motors_by_brute_force"),
    M("events: those that form again bear too little", "engine/events.py", "y = now.X + now.moved",
      "y = 0.9 * (now.X + now.moved)", "test_events.py::test_mean_life_of_bonds"),
    M("avalanches: force kept by broken contacts", "engine/avalanches.py", "now.force -= stiffness",
      "now.force -= 0.99 * stiffness", "test_slider.py::test_avalanches_one_by_one"),
    M("blocks: an edge that reflects nothing", "engine/lattice.py", "if begin < end:",
      "if begin < end and (image == 0 or r.periodic):", "test_elastic.py::test_avalanches_one_by_one"),
    M("blocks: contacts that break early", "engine/elastic.py", "b.contact[block], position + b.xi",
      "b.contact[block], position + 0.99 * b.xi", "test_elastic.py::test_avalanches_one_by_one"),
    M("blocks: one that breaks twice counts twice", "engine/elastic.py", "if b.last[block] != now.avalanches:",
      "if b.last[block] >= 0:", "test_elastic.py::test_avalanches_one_by_one"),
    M("blocks: stored energy", "engine/elastic.py", "stored = 0.5 * (n * X**2 - 2.0", "stored = 0.5 * (n * X**2 - 1.9",
      "test_elastic.py::test_exact_numbers"),
    M("blocks: what is cut off is lost", "model/elastic.py", "found[reach[0], reach[1]] += self.branching",
      "found[reach[0], reach[1]] += 0.9 * self.branching", "test_elastic.py::test_response_is_the_inverse"),
    M("blocks: progeny of nobody", "master/avalanche_sizes.py", "power.mean().real / s", "power.mean().real / (s + 1)",
      "test_elastic.py::test_size_law"),
    M("slider: half of what is missed", "engine/slider.py", "distance = -0.5 * missed / held",
      "distance = 0.0 * missed / held", "test_stage_steps.py::test_what_a_step_misses_is_made_up_for"),
    M("slider: what is missed is not forgotten in time", "engine/slider.py", "min(1.0, dt / self.over)", "min(0.1, dt)",
      "test_stage_steps.py::test_behind_is_made_up_for_within_the_time_it_took"),
    M("slider: errors without the step", "engine/slider_runs.py", "    if again is not None:", "    if False:",
      "test_stage_steps.py::test_errors_grow_with_the_tolerance"),
    M("chain: springs between neighbours push", "engine/chain_steps.py", "net -= links.coupling * apart",
      "net += links.coupling * apart", "test_chain.py::test_springs_masses_and_dampers"),
    M("chain: a neighbour is missing", "engine/chain_steps.py",
      "    elif links.periodic:\n        total += x[j] - x[0]", "    elif False:\n        total += x[j] - x[0]",
      "test_chain.py::test_springs_masses_and_dampers"),
    M("chain: breaks take no energy", "engine/chain_steps.py", "s.lost += lost / size", "s.lost += 0.0",
      "test_chain.py::test_energy_is_kept"),
    M("chain: what is missed is not given back", "engine/chain_steps.py", "b.gain[j] = -missed / dt",
      "b.gain[j] = 0.0", "test_chain.py::test_front_in_long_steps"),
    M("chain: what a front misses is given back as slowly as it was loaded", "engine/chain_steps.py",
      "left = dt + (left - dt) * old / (old + abs(lag[j]))", "left = max(left, dt)",
      "test_chain.py::test_front_in_long_steps"),
    M("slips: none at the end of a record", "engine/readings.py", "if distance > 2.0 * fastest * time:",
      "if distance > 2.0 * fastest * time and low < t.size - 1:", "test_stage.py::test_slips_that_a_record_cuts"),
    M("slips: cut ones in the mean", "engine/records.py", "in whole if slip.ended][1:]",
      "in whole][1:]", "test_stage.py::test_whole_slips_make_the_means"),
    M("reference: a peak where the stage is", "workflows/run.py", "._replace(X=exact.X)", "",
      "test_stage.py::test_the_exact_peak_is_where_the_slider_is"),
    M("bursts: each break begins one", "master/bursts.py", "np.exp(-e) * (1.0 - a)", "np.exp(-e)",
      "test_bursts.py::test_hemmer_and_hansen"),
    M("bursts: thresholds without their stiffness", "master/bursts.py",
      "a * kappa_of(contacts, x / law.scale) / ahead", "a",
      "test_bursts.py::test_integral_of_the_stiffness_weighted_law"),
    M("lifetimes: the time after a birth is that before", "master/lifetimes.py", "t = t, stay * (1 + gain * t)",
      "t = t, stay * (1 + gain * stay)", "test_lifetimes.py::test_published_means"),
    M("lifetimes: half of the first term twice", "master/lifetimes.py", "series[0] *= 0.5", "series[0] *= 1.0",
      "test_lifetimes.py::test_survival_is_the_exponential_of_the_chain"),
    M("motors: the substrate holds nothing", "master/slider.py", "damping = c + c_held * held + now.damping",
      "damping = c + now.damping", "test_forces_and_motors.py::test_motors"),
    M("forces: a segment begins at its end", "master/slider.py", "at_marks = forces[i] + rates[i] * (marks - ends[i])",
      "at_marks = forces[i]", "test_forces_and_motors.py::test_a_bundle_under_a_ramp_lets_go"),
    M("motors: one that stands is taken for steady", "master/steady.py", "if not above[i]]", "]",
      "test_motors.py::test_several_steady_velocities"),
    M("avalanches: k in place of k_t", "master/avalanche_sizes.py", "return law.rms / law.mean if", "return 1.0 if",
      "test_slider.py::test_sqrt_avalanches_in_closed_form"),
    M("avalanches: travel in place of the force lost", "master/avalanche_sizes.py",
      "drop = xi * relative_stiffness(stiffness, xi, law.rms / law.scale)", "drop = xi",
      "test_slider.py::test_sqrt_avalanches_in_closed_form"),
    M("avalanches: few contacts are many", "master/avalanche_sizes.py", "begins = 1.0 - load * (1.0 - 1.0 / contacts)",
      "begins = 1.0 - load", "test_elastic.py::test_few_contacts_of_uncoupled_blocks"),
    M("validation: largest score alone", "validation/verdict.py", "-math.expm1(z.size * math.log1p(",
      "-math.expm1(math.log1p(", "test_validation.py::test_verdict"),
    M("validation: alarm at 1e-6", "validation/verdict.py", "ALARM = 1e-4", "ALARM = 1e-6",
      "test_validation.py::test_verdict"),
    M("validation: too good is passed", "validation/verdict.py",
      "tails = stats.chi2.cdf(total, even.size), stats.chi2.sf(total, even.size)",
      "tails = stats.chi2.sf(total, even.size), 1.0", "test_validation.py::test_verdict"),
    M("validation: two contacts do not move the slider", "validation/pulled.py",
      "alone = 2.0 * kappa * pull / (2.0 * kappa + k)", "alone = 2.0 * kappa * pull / (2.0 * kappa + 2.0 * k)",
      "test_hold_oracle.py::test_two_contacts"),
    M("validation: two contacts break at the rate of either", "validation/pulled.py",
      "np.where(pair, weak_rate + strong_rate, 0.0)", "np.where(pair, weak_rate, 0.0)",
      "test_hold_oracle.py::test_two_contacts"),
    M("validation: law of sizes with k in place of k_t", "master/avalanche_sizes.py", "return k / (k + spring)",
      "return 1.0 / (1.0 + spring)",
      "test_validation.py::test_avalanches_know_the_stiffness_that_shares_the_force"),
    M("validation: sign of a score", "validation/comparison.py", "score = math.inf if z is None else z",
      "score = math.inf if z is None else -z", "test_validation.py::test_signs_of_scores"),
    M("validation: score for error in the table", "validation/comparison.py", '"sigma": score.sigma, "z": score.z,',
      '"sigma": score.z, "z": score.sigma,', "test_validation.py::test_signs_of_scores"),
    # sweep
    M("sweep: sign of a score", "sweeps/rows.py", "z = z_score(ours, level.value, level.stderr or 0.0)",
      "z = (lambda z: z and -z)(z_score(ours, level.value, level.stderr or 0.0))",
      "test_sweep.py::test_rows_are_what_steady_and_reference_say"),
    M("sweep: number of lives as degrees of freedom", "sweeps/rows.py",
      'f"{name}_dof": ours.dof', 'f"{name}_dof": ours.n',
      "test_sweep.py::test_rows_are_what_steady_and_reference_say"),
    M("sweep: two deaths end a point", "sweeps/scheduler.py", "_LOSSES = 3", "_LOSSES = 2",
      "test_sweep.py::test_a_point_that_kills_its_workers_is_found_out"),
    M("sweep: deaths in company count", "sweeps/scheduler.py", "self.losses[index] += alone", "self.losses[index] += 1",
      "test_sweep.py::test_a_point_that_kills_its_workers_is_found_out & "
      "test_sweep.py::test_workers_that_die_now_and_then_do_not_end_the_sweep"),
    M("sweep: deaths are never forgotten", "sweeps/scheduler.py", "            self.deaths = 0\n", "",
      "test_sweep.py::test_workers_that_die_now_and_then_do_not_end_the_sweep"),
    M("sweep: deaths without end", "sweeps/scheduler.py", "self.deaths > 4 * _LOSSES", "self.deaths > 40 * _LOSSES",
      "test_sweep.py::test_workers_that_never_live_end_the_sweep"),
    M("sweep: unreliable is ok", "sweeps/rows.py", '"unreliable" if problems else "ok"', '"ok"',
      "test_sweep.py::test_what_cannot_be_trusted_is_unreliable"),
    M("sweep: damaged parts are taken", "sweeps/store.py", 'path.stem == f"part-{_digest(content)}"', "True",
      "test_sweep.py::test_damaged_parts_are_named_and_computed_again"),
    M("sweep: hidden parts are forgotten", "io/storage.py", "in (SWEEP_PARTS, SWEEP_HIDDEN))",
      "in (SWEEP_PARTS,))",
      "test_sweep.py::test_death_before_the_table_has_its_name_loses_nothing"),
    # units
    M("units: the unit of energy is left out", "io/units.py", "constants.k * temperature / (self.size(ENERGY) or 1.0)",
      "constants.k * temperature", "test_units.py::test_kelvin"),
    M("units: stress in the units of the run file", "io/units.py", "density * k * (size or 1.0), unit",
      "density * k, unit", "test_units.py::test_what_is_known_of_which_interface"),
    M("units: the error stays a length", "io/units.py", "else stderr * abs(self.factor)", "else stderr",
      "test_units.py::test_errors_go_along_and_prefixes_are_chosen"),
    M("units: a swept temperature keeps its kT", "io/runfile.py", 'file.given["thermal"].pop("kT", None)', "pass",
      "test_units.py::test_a_temperature_is_a_kT"),
    M("plot: neighbours with one name", "plots/sweeps.py", "for digits in range(7, 18):",
      "for digits in range(0):", "test_plot.py::test_where_accepts_what_it_prints"),
    M("plot: newtons in the place of the coefficient", "plots/sweeps.py",
      "found._replace(factor=found.factor / drawn[0].factor)", "found",
      "test_plot.py::test_a_sweep_knows_its_title_units_and_curve"),
    M("plot: titles as long as they are", "plots/sweeps.py", "title = wrapped(title, 0.75 * (width or 9.0))",
      "pass", "test_plot.py::test_two_columns_of_a_table_on_a_column_of_a_page"),
    M("plot: a curve of the wrong temperature", "plots/sweeps.py", "file = _point(sweep, row, more)",
      "file = at(sweep.file, more)", "test_plot.py::test_a_sweep_knows_its_title_units_and_curve"),
    # grid
    M("grid: seeds of 31 bits", "sweeps/plan.py", "int(point_id[:16], 16) >> 1", "int(point_id[:8], 16) >> 1",
      "test_grid.py::test_seeds_of_points_differ"),
    M("grid: axes of five digits", "sweeps/plan.py", "{x:.12g}", "{x:.5g}",
      "test_grid.py::test_inner_values_of_an_axis_have_twelve_digits"),
    M("grid: seeds are no part of a point", "sweeps/plan.py", "json.dumps([values, seed, RESULTS_VERSION]",
      "json.dumps([values, RESULTS_VERSION]", "test_grid.py::test_identity_depends_on_what_a_value_depends_on"),
    M("grid: the results version is no part of a point", "sweeps/plan.py", "json.dumps([values, seed, RESULTS_VERSION]",
      "json.dumps([values, seed]", "test_grid.py::test_identity_depends_on_what_a_value_depends_on"),
    M("sweep: results of two versions in a folder", "sweeps/store.py", "in sorted(known) if",
      "in sorted(known - {_VERSION}) if", "test_sweep.py::test_a_folder_of_another_results_version_says_what_to_do"),
    M("sweep: a table names the libraries of its first rows only", "sweeps/store.py",
      '", ".join(known) for', "known[0] for", "test_sweep.py::test_a_table_names_all_libraries_that_made_it"),
    M("grid: tables by their name", "sweeps/plan.py", 'values[f"{above}thresholds.file"] = digest',
      'values[f"{above}thresholds.sha"] = digest', "test_grid.py::test_a_table_of_thresholds_enters_with_its_values"),
    M("grid: tables of populations by their name", "sweeps/plan.py", "enumerate(ensemble.populations):",
      "enumerate(()):", "test_grid.py::test_a_table_of_a_population_enters_with_its_values"),
    M("sweep: failures beyond the first ones are not told", "cli/survey.py", "found.failed - len(failures)", "0",
      "test_sweep.py::test_failed_and_unreliable_points_do_not_stop_the_others"),
    M("plot: of two values of a key the last one counts", "cli/survey.py", "if key in chosen:", "if key in ():",
      "test_plot.py::test_refusals"),
    M("export: a table over itself", "cli/check.py", "sources = {part.resolve() for part in chain(*found.values())}",
      "sources = set()", "test_export.py::test_tables_are_not_overwritten"),
    M("new: a file is written before its thresholds are read", "cli/begin.py",
      "tomllib.loads(text), path.parent).ensemble", "tomllib.loads(text), path.parent)",
      "test_cli.py::test_bad_new_run_files"),
    M("rsf: noise of a run file does nothing", "cli/fit.py", "if self.noise:", "if False:",
      "test_cli.py::test_options_are_named_as_they_are_typed"),
    M("run: what was not seen is exact", "workflows/report.py", '"none" if None in numbers else',
      '"none" if None in numbers[2:] else', "test_cli.py::test_differences_from_what_is_expected"),
    M("run: a peak in another unit is called a force", "workflows/run.py",
      "peak_{quantity.short if quantity else 'force'}", "peak_force",
      "test_cli.py::test_the_peak_is_called_what_it_is"),
    M("terminal: counts that round up", "io/terminal.py", 'number = float(f"{number:.3g}")', "number = float(number)",
      "test_cli.py::test_rounded_counts_and_times"),
    M("plot: heat of a fixed temperature along a curve", "plots/sweeps.py", "and key not in replaced", "",
      "test_plot.py::test_keys_that_follow_from_others"),
    M("plot: an axis of one value is not that of the curve", "plots/sweeps.py", "if kind(row[key]) != base[key]",
      "if table[key].nunique() > 1", "test_plot.py::test_an_axis_of_a_single_value_is_that_of_the_curve"),
    M("plot: a curve along one of two populations", "plots/sweeps.py",
      "if _top(table, key) == _top(table, x))", "if key == x)", "test_plot.py::test_keys_that_follow_from_others"),
    M("run file: the temperature of a population beside its kT", "io/content.py", "_ALTERNATIVES.get(bare)",
      "_ALTERNATIVES.get(key)", "test_population_files.py::test_a_temperature_of_a_population_replaces_its_heat"),
    M("plot: values that are not reliable are filled", "plots/sweeps.py", "unsure |= members[reliable].eq(False)",
      "pass", "test_plot.py::test_points_of_a_column_that_is_not_reliable_are_open"),
    M("run: avalanches with heat beside a law", "workflows/run.py", "changing = (contacts.thermal,", "changing = (",
      "test_forces.py::test_a_run_behind_a_stage_draws_its_avalanches"),
    M("run: drops of slips in the unit of forces over N k", "workflows/run.py", "sizes = (factor * slip.drop,",
      "sizes = (slip.drop,", "test_stage.py::test_drops_are_shown_as_a_coefficient_where_it_is_known"),
    M("run: a picture of an earlier run is not told", "io/storage.py", '(".csv", ".png", ".pdf", ".svg")', '(".csv",)',
      "test_outputs.py::test_tables_of_an_earlier_run_are_named"),
    M("picture: labels beyond the page", "plots/panels.py",
      'axes.yaxis.set_major_locator(MaxNLocator("auto", integer=True))', "pass",
      "test_pictures.py::test_labels_are_within_the_page"),
    M("grid: the value that a sweep replaces counts", "sweeps/store.py", "- swept(plan.file)", "- set()",
      "test_sweep.py::test_what_the_sweep_replaces_may_change"),
    # tables
    M("tables: text without quotes", "io/csv.py", "else _quoted(str(value))", "else str(value)",
      "test_export.py::test_text_with_comment_signs"),
    M("tables: whole numbers as floats", "io/csv.py", "return repr(value) if", "return repr(float(value)) if",
      "test_csv.py::test_pandas_reads_what_is_exported"),
    M("tables: a row of nothing is no line", "io/csv.py", "map(_cell, row)) or '\"\"'", "map(_cell, row))",
      "test_csv.py::test_what_is_exported_is_read_again"),
    M("csv: comments begin in the first column only", "io/csv.py", '_COMMENT.match(begin)', '_COMMENT.match(line)',
      "test_csv.py::test_every_row_is_read"),
    M("csv: a quote ends where it likes", "io/csv.py", '([^"\\s{separator}][^{separator}]*|)', "([^{separator}]*)",
      "test_csv.py::test_a_line_that_is_no_row_is_refused"),
    M("csv: cells that are not there are empty", "io/csv.py", "if len(cells) < width:", "if not cells:",
      "test_csv.py::test_a_line_that_is_no_row_is_refused"),
    M("csv: a first line of numbers is a name", "io/csv.py", "([.,]?\\d|(nan", "((nan",
      "test_runfile.py::test_bad_tables"),
    M("series: errors of equal times do not shrink", "io/series.py", "np.sqrt(rows[:, -1] / merged)",
      "np.sqrt(rows[:, -1])", "test_variants.py::test_equal_times_are_merged_with_their_errors"),
    M("series: blocks by scatter of rows alone", "io/series.py", "+ unseen + known.noise**2)", "+ 1.0)",
      "test_series.py::test_blocks_smear_nothing"),
    M("series: a gap is a number", "io/csv.py", "            gaps += 1\n            continue\n",
      "            gaps += 1\n",
      "test_variants.py::test_a_variant_is_read_or_refused"),
    M("fits: a trend per time", "fitting/record.py", 'fit.trend.per == "displacement"', 'fit.trend.per == "time"',
      "test_record.py::test_hardening_goes_with_slip"),
    M("fits: rows are not checked", "fitting/fit.py", "    _check_rows(file, table)\n", "",
      "test_fit.py::test_bad_input[velocity of 0]"),
    M("tables: units of the sweep of a run", "io/export.py", '_SETTINGS.get(str(origin.get("command")))', '"sweep"',
      "test_export.py::test_units"),
    M("sweep: rows of one at work are not seen", "io/storage.py", "in (SWEEP_PARTS, SWEEP_HIDDEN))",
      "in (SWEEP_HIDDEN,))", "test_export.py::test_an_unfinished_sweep"),
    M("options: an empty path is here", "cli/options.py", "if not str(text).strip():", "if not text:",
      "test_cli.py::test_no_path_is_empty"),
    M("tables: thresholds as they stand in the file", "io/tables.py", "values.append(value * scale)",
      "values.append(value)", "test_runfile.py::test_columns_and_scale_of_tables"),
    M("help: sections are markup", "cli/options.py", 'escape(inspect.cleandoc(command.__doc__ or ""))',
      'inspect.cleandoc(command.__doc__ or "")', "test_cli.py::test_help_says_what_is_written"),
    M("peak: the highest of many teeth", "master/peak.py", "np.where(X[first] + 0.5 * period >= X, force, -np.inf)",
      "force", "test_peak.py::test_contacts_in_step_have_the_first_of_many_peaks"),
    M("peak: a grid point, however coarse", "workflows/peak.py", "where, height = vertex(X, force, top)",
      "where, height = X[top], 0.97 * force[top]", "test_peak.py::test_simulated_peaks_are_the_exact_one"),
    M("peak: any grid resolves it", "master/peak.py", "_ROUND = 0.3", "_ROUND = 1e9",
      "test_peak.py::test_peaks_narrower_than_the_grid"),
    M("peak: tips of discrete thresholds only", "workflows/peak.py", "if missed.force < noise and not", "if not",
      "test_peak.py::test_peaks_narrower_than_the_grid"),
    M("peak: the highest point is in the highest tooth", "master/peak.py", "force + missed >= force[top] - unsure",
      "force >= force[top]", "test_peak.py::test_peaks_narrower_than_the_grid"),
    M("peak: a vertex beyond the record", "engine/readings.py", "< 0 and within:", "< 0:",
      "test_protocols.py::test_places_of_peaks_are_where_the_force_is"),
    M("transient: errors of what is there now", "master/transient.py", "np.maximum.accumulate(np.abs(best), axis=1)",
      "np.abs(best)", "test_convolution.py::test_transients_are_those_of_the_lattice"),
    M("transient: all of a tooth is an error", "master/transient.py",
      "bends = np.diff(values, 2)", "bends = np.diff(values)[..., 1:]",
      "test_convolution.py::test_errors_are_those_of_the_force_that_is_there"),
    M("stability: steps of a table are slips", "master/stability.py", "math.ceil(least / h",
      "math.ceil(0.2 * least / h", "test_stability.py::test_steps_that_are_slips"),
    M("stability: slopes at kinks as between kinks", "master/stability.py",
      "_BETWEEN_GRIDS = 2.0", "_BETWEEN_GRIDS = 1.0",
      "test_stability.py::test_fresh_slip_at_the_edge_of_a_law"),
    M("stability: only those that started together", "master/stability.py", "-(slope + later(at))", "-slope",
      "test_stability.py::test_fresh_slip_at_the_edge_of_a_law"),
    M("tables: private files", "io/storage.py", 'open(staging / name, "wb") as',
      'open(os.open(staging / name, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o600), "wb") as',
      "test_faults.py::test_anyone_can_read_what_is_written"),
    M("tables: NaN in JSON", "io/storage.py", "not math.isfinite(value):\n            return None",
      "not math.isfinite(value):\n            return 0.0", "test_properties.py::test_json_is_never_nan"),
    M("tables: pages unchecked", "io/storage.py", "checksums=True)\n    except", "checksums=False)\n    except",
      "test_sweep.py::test_page_checksums_see_every_byte_of_the_data"),
    M("tables: read by threads", "io/storage.py", ".read(use_threads=False)", ".read()",
      "test_export.py::test_tables_are_read_without_threads"),
    M("tables: written in place", "io/storage.py", 'open(staging / name, "wb") as', 'open(folder / name, "wb") as',
      "test_faults.py::test_killed_at_every_step_of_writing"),
    # interrupts
    M("interrupts: pools of threads go on", "numerics/threads.py", "            pool._tell()\n", "            pass\n",
      "test_interrupts.py::test_pools_of_threads_are_stopped_with_them"),
    M("interrupts: compilers are waited for", "numerics/threads.py", "join(None if wait else ", "join(None and ",
      "test_interrupts.py::test_a_thread_that_does_not_look_is_abandoned"),
    M("interrupts: the mean field goes on", "master/slider.py", "path = path._replace(stop=thread.stop)", "pass",
      "test_interrupts.py::test_a_solver_of_the_mean_field_is_told"),
    M("interrupts: avalanches go on", "engine/avalanches.py", "while way.stop[0] == 0:", "while True:",
      "test_interrupts.py::test_avalanches_end_when_they_are_told"),
    M("interrupts: temporary files stay", "io/signals.py", "for undo in reversed(_undo):", "for undo in ():",
      "test_interrupts.py::test_a_process_that_cannot_answer_leaves_no_temporary_file"),
    M("interrupts: a lost one does nothing", "io/signals.py", "acknowledged.wait(_ANSWER)", "acknowledged.wait()",
      "test_faults.py::test_an_interrupt_that_is_lost_ends_the_process_all_the_same"),
    # replay, workers, errors
    M("replay: identities of now", "workflows/replay.py", ', table["id"].tolist())', ")",
      "test_replay.py::test_a_sweep_of_an_older_version"),
    M("run: a steady value of another seed", "workflows/run.py", "rough, seed=output.seed", "rough, seed=1",
      "test_cli.py::test_run_json_and_replicas"),
    M("replay: longer tables are the same", "workflows/replay.py", "(table) != len(again)", "(table) < len(again)",
      "test_replay.py::test_compare"),
    M("replay: NaN differs from NaN", "workflows/replay.py", "| (then.isna() & now.isna())", "",
      "test_replay.py::test_compare"),
    M("replay: columns that came later", "workflows/replay.py",
      "for name in [*table, *(name for name in again if name not in table)]", "for name in [*table]",
      "test_replay.py::test_compare"),
    M("workers: one thread for ever", "sweeps/workers.py", "                os.environ[name] = value\n",
      '                os.environ[name] = "1"\n', "test_faults.py::test_one_thread_is_asked_of_workers_alone"),
    M("workers: threads as they like", "sweeps/workers.py", 'os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))',
      "os.environ.update()", "test_faults.py::test_one_thread_is_asked_of_workers_alone"),
    M("errors: True is 1", "errors.py", "isinstance(value, int) and not isinstance(value, bool)",
      "isinstance(value, int)", "test_runfile.py::test_integers_are_integers"),
    M("records: forces of one run as if independent", "engine/readings.py",
      "        if self.parts is None:\n            error = float(", "        if True:\n            error = float(",
      "test_protocols.py::test_errors_of_differences_know_that_forces_are_correlated"),
    M("healing: natural logarithm", "model/healing.py", "rate * np.log10(1.0", "rate * np.log(1.0",
      "test_protocols.py::test_healing_is_fitted_by_its_logarithm"),
    M("load: a fall takes away added contacts only", "model/load.py", "left[first:] *= min(load / before, 1.0)",
      "pass", "test_load.py::test_steps_by_closed_form"),
    M("load: contacts added at a rate count from the start", "model/load.py",
      "left * x * (np.arange(left.size) >= since)", "left * x.max(initial=0.0)",
      "test_load.py::test_rates_by_closed_form"),
    M("units: a machine per millimetre", "io/units.py", "return given[0] * size / (one.factor * unit)",
      "return given[0] / (one.factor * unit)", "test_units.py::test_a_machine_in_its_own_units"),
    M("errors: bounds that are not above", "errors.py", "(above is None or value > above)",
      "(above is None or value >= above)", "test_runfile.py::test_bounds_of_numbers"),
    M("calls: options of a run file are not heeded", "calls.py", "for x in options if x not in known",
      "for x in options if x in known", "test_api.py::test_a_run_file_is_its_contacts_and_drive"),
    M("calls: the drive of a run file wins", "calls.py", "drive = drive_of(file) if drive is None else drive",
      "drive = drive_of(file)", "test_api.py::test_a_drive_in_the_place_of_the_drive_of_a_run_file"),
    M("results: errors are not converted", "results.py", "None if stderr is None else one.factor * stderr",
      "stderr", "test_api.py::test_units_are_those_of_the_command_line"),
    M("results: parts are not told units", "results.py", "            tell_quantities(part, quantities)",
      "            continue", "test_api.py::test_units_are_those_of_the_command_line"),
    # chains of blocks
    M("chains: load of the first break with a block too many", "master/chains.py", "grown = z ** (2 * blocks)",
      "grown = z ** (2 * blocks + 2)", "test_chains.py::test_the_load_of_the_first_break_is_that_of_a_solved_chain"),
    M("chains: the edge has two neighbours", "master/chains.py", "band[1, [0, -1]] -= coupling",
      "band[1, -1] -= coupling", "test_chains.py::test_loads_of_precursors_are_rational"),
    M("chains: blocks of few contacts push as others do", "master/chains.py", "G[:, ready] @ weight[ready]",
      "G[:, ready].sum(axis=1)", "test_chains.py::test_precursors_of_two_blocks_of_unequal_load"),
    M("chains: force on an edge without the two of an energy", "master/chains.py", "np.sqrt(2.0 * coupling *",
      "np.sqrt(coupling *", "test_chains.py::test_the_force_on_an_edge_follows_from_the_work"),
    M("chains: static friction is the largest that is tried", "master/chains.py", "return -float(found.fun)",
      "return float(per_block(tried).max())",
      "test_chains.py::test_static_friction_falls_with_length_from_peak_to_steady_friction"),
    M("fronts of chains: nothing beyond the last period", "master/chain_fronts.py",
      "return Estimate(float(table[0]), 2.0", "return Estimate(sums[-1], 2.0",
      "test_chain_fronts.py::test_prestress_and_speed_of_contacts_with_stiffness"),
    M("fronts of chains: a root at zero without its frequency", "master/chain_fronts.py",
      "(self.drive_stiffness or self.damping * g)", "(self.drive_stiffness or self.damping)",
      "test_chain_fronts.py::test_fronts_faster_than_sound"),
    M("fronts of chains: traps forget the plate", "master/chain_fronts.py", "ahead = 1.0 + drive_stiffness",
      "ahead = 1.0", "test_chain_fronts.py::test_slow_fronts_are_trapped"),
    M("fronts of chains: plate springs in one of two stretches", "master/chain_fronts.py",
      "value = 1.0 - 0.5 / held +", "value = 0.5 +",
      "test_chain_fronts.py::test_slow_fronts_are_trapped"),
    M("modes: blocks at the ends have two neighbours", "master/chain_modes.py",
      "chain.coupling * chain.neighbours + chain.springs - K_d", "2.0 * chain.coupling + chain.springs - K_d",
      "test_chain_modes.py::test_chains_that_are_pulled_at_the_edge_are_stable_if_they_are_short"),
    M("modes: bulk damping drives", "master/chain_modes.py", "loop.damping + damping", "loop.damping - damping",
      "test_chain_modes.py::test_the_critical_wave_number_is_that_of_the_critical_stiffness"),
    M("modes: growth of the softest per threshold", "master/chain_modes.py", "Estimate(rate * float(p.real[-1]),",
      "Estimate(float(p.real[-1]),", "test_chain_modes.py::test_a_mode_is_a_slider_behind_a_stiffer_spring"),
    M("modes: each block has one neighbour", "master/chain_modes.py", "bend = 2.0 - 2.0 * math.cos(q)",
      "bend = 1.0 - math.cos(q)", "test_chain_modes.py::test_a_mode_is_a_slider_behind_a_stiffer_spring"),
    M("creep of chains: springs beyond the ends", "master/chain_creep.py",
      "springs[[0, -1], [0, -1]] -= coupling", "springs[[0, -1], [0, -1]] -= 0.0 * coupling",
      "test_chains.py::test_mean_lives_of_few_contacts"),
    M("creep of chains: the edge is half a block further on", "master/chain_creep.py",
      "(weights * np.cos(0.5 * q) ** 2)", "(weights * np.cos(0.5 * q))",
      "test_chains.py::test_contacts_that_forget_let_the_edge_creep_as_a_diffusion"),
    M("creep of chains: hazard without the scale of its stretch", "master/chain_creep.py",
      "special.dawsn(math.sqrt(b) * x) / math.sqrt(b)", "special.dawsn(math.sqrt(b) * x)",
      "test_chains.py::test_steady_creep_between_its_limits"),
    M("creep of chains: all contacts of a set break at once", "master/chain_creep.py",
      "return float((1.0 + later) / rates.sum())", "return float(1.0 / rates.sum() + later / rates.size)",
      "test_chains.py::test_mean_lives_of_few_contacts"),
    M("mean field of a chain: springs to the plate do not yield", "master/chain_field.py",
      "net += speed * dt * links.plate - springs @ dX", "net += speed * dt * links.plate - links.coupling * L @ dX",
      "test_chain_field.py::test_one_block_is_a_slider_behind_a_stage"),
    M("mean field of a chain: the force of before a step is that of its start", "master/chain_field.py",
      "force = np.linalg.inv(matrix), means[:, 0, m - 1]", "force = np.linalg.inv(matrix), means[:, 0, 0]",
      "test_chain_field.py::test_one_block_is_a_slider_behind_a_stage"),
    M("chain: the last block has two neighbours", "model/chain.py", "            found[-1] -= 1.0",
      "            found[-1] -= 0.0", "test_chain.py::test_springs_masses_and_dampers"),
    M("chain: the square of the speed of waves", "model/chain.py",
      "return math.sqrt(self.coupling / self.mass) if", "return self.coupling / self.mass if",
      "test_chain.py::test_fronts_are_named_by_the_speed_of_waves"),
    M("chain: the spring at the edge in place of that to the plate", "model/elastic.py",
      "springs[0] += self.edge_stiffness or 0.0", "springs[0] = self.edge_stiffness or springs[0]",
      "test_chain.py::test_springs_masses_and_dampers"),
    M("chain: the spring that closes a ring stores nothing", "engine/chain.py",
      "append=b.X[:1] if links.periodic else b.X[-1:]", "append=b.X[-1:]",
      "test_chain.py::test_energy_is_kept"),
    M("chain: velocities of blocks as if they were lengths", "engine/chain.py", '| {"V": (1, -1)}', '| {"V": (1, 0)}',
      "test_chain.py::test_results_in_other_units"),
    M("chain: energies of events as if they were forces", "engine/chain.py", '"energy": (2, 0)', '"energy": (1, 0)',
      "test_chain.py::test_results_in_other_units"),
    M("chain: forces of the drive from the first block", "engine/chain.py", "np.mean(springs, axis=(0, 2)) * unit",
      "np.mean(springs[..., 0], axis=0) * unit", "test_chain.py::test_records_and_threads"),
    M("fronts of chains: error of the speed by that of the slope", "engine/chain_records.py",
      "error = line.stderr * speed**2", "error = line.stderr * speed",
      "test_chain.py::test_errors_of_fronts_have_the_unit_of_their_speed"),
    M("fronts of chains: any rising line is one", "engine/chain_records.py", "line.slope <= 2.0 * line.stderr",
      "line.slope <= 0.0", "test_chain.py::test_errors_of_fronts_have_the_unit_of_their_speed"),
    M("fronts of chains: they end where they begin", "engine/chain_records.py",
      "start = min(t, key=t.__getitem__)", "start = max(t, key=t.__getitem__)",
      "test_chain.py::test_fronts_are_straight_lines"),
    M("events of chains: static friction with that of the start", "engine/chain_records.py",
      "lambda peak: peak[1:]", "lambda peak: peak", "test_chain.py::test_means_over_events_and_slip"),
    M("events of chains: those of all blocks are precursors", "engine/chain_records.py",
      "== self.chain.count) == whole", "== self.chain.count) >= whole",
      "test_chain.py::test_means_over_events_and_slip"),
    M("events of chains: recurrence from the first event on", "engine/chain_records.py",
      "lambda t: np.diff(t[1:])", "lambda t: np.diff(t)",
      "test_chain.py::test_means_over_events_and_slip"),
    M("chain: ranks of slip from zero on", "engine/chain_records.py", "- slip.size - 1.0", "- slip.size + 1.0",
      "test_chain.py::test_means_over_events_and_slip"),
    M("chain: roughness of the last replica", "engine/chain_records.py",
      "np.sqrt(np.mean([X.var(axis=1) for X in each], axis=0))", "np.sqrt(each[-1].var(axis=1))",
      "test_chain.py::test_means_over_events_and_slip"),
    M("chain: dampers between neighbours take nothing in the second half", "engine/chain_steps.py",
      "        damped += links.bulk * _differences(links, x, j)\n", "",
      "test_chain.py::test_springs_masses_and_dampers"),
    M("chain: inertia of a whole step", "engine/chain_steps.py", "inertia = links.mass / (b.theta[j] * dt * dt)",
      "inertia = links.mass / (dt * dt)", "test_chain.py::test_springs_masses_and_dampers"),
    M("chain: corners of a ring", "engine/chain_steps.py", "diagonal[last] -= off * off / head",
      "diagonal[last] += off * off / head", "test_chain.py::test_springs_masses_and_dampers"),
    M("chain: the second half of a step forgets the first", "engine/chain_steps.py",
      "_SECOND = 1.0 / (_GAMMA * (2.0 - _GAMMA))", "_SECOND = 1.0 / (2.0 - _GAMMA)",
      "test_chain.py::test_springs_masses_and_dampers"),
    M("chain: twice the kinetic energy", "engine/chain_steps.py", "kinetic = 0.5 * links.mass *",
      "kinetic = links.mass *", "test_chain.py::test_energy_is_kept"),
    M("chain: breaks are never forgotten", "engine/chain_steps.py", "kept = math.exp(-breaks / MEMORY)",
      "kept = 1.0", "test_chain.py::test_one_block_is_a_slider_bit_for_bit"),
    M("events of blocks: annealed rates are bounded by that at the wall", "laws/barrier/pooled.py",
      "most = max(most, law.greatest[cell])", "most = law.greatest[cell]",
      "test_block_events.py::test_annealed_rates_that_rise_to_every_threshold"),
    M("blocks: avalanches that were not met are not", "engine/elastic.py", "_UNMET = 2.0", "_UNMET = 0.0",
      "test_elastic.py::test_avalanches_that_were_not_met_have_errors"),
    M("chains: means over events know no steps", "engine/chain_records.py",
      "mean(self.coarser_events))", "mean(self.events))",
      "test_chain.py::test_means_over_events_and_slip"),
    M("blocks: what no replica has met is not", "engine/elastic.py",
      "unmet = interface.kept * unmet_force", "unmet = 0.0 * unmet_force",
      "test_elastic.py::test_replicas_that_have_met_no_break_have_errors"),
    M("events of blocks: springs bear nothing of a break", "engine/block_events.py",
      "now.force -= x * b.kept[block]", "now.force -= x", "test_block_events.py::test_avalanches_one_by_one"),
    M("events of blocks: what others bear of a break, without their loads", "engine/block_events.py",
      "kept[breaks] = 1.0 - weights @ moved", "kept[breaks] = 1.0 - moved.sum(axis=0)",
      "test_block_events.py::test_avalanches_one_by_one"),
    M("events of blocks: the level rises with the plate, whatever its springs", "engine/block_events.py",
      "speed=interface.speed * float(instants.speeds[segment])", "speed=float(instants.speeds[segment])",
      "test_block_events.py::test_one_block_is_a_slider_behind_a_stage"),
    M("events of blocks: every candidate breaks", "engine/block_events.py", "if v * b.bound[contact] >= actual:",
      "if v * b.bound[contact] > b.bound[contact]:",
      "test_block_events.py::test_stiff_springs_to_the_plate_make_a_rigid_slider"),
    M("fronts of chains: pictures of lines that all run to the right", "plots/chains.py",
      'fronts["block"][i] + fronts["direction"][i] * steps', 'fronts["block"][i] + steps',
      "test_chain.py::test_pictures_have_the_lines_of_fronts"),
    M("fronts of chains: pictures of a slope for a speed", "plots/chains.py", "- begin + steps / speed",
      "- begin + steps * speed", "test_chain.py::test_pictures_have_the_lines_of_fronts"),
    # bonds, bundles, clusters and motors
    M("Bell: rate at the end for its mean over the way", "laws/barrier/bell.py",
      "np.minimum(log_mean(a * x), MOST)", "np.minimum(a * x, MOST)",
      "test_bonds.py::test_rupture_force_on_a_ramp"),
    M("Bell: a step at the rate of its end", "laws/barrier/bell.py",
      "min(law.b * k * x + way, MOST)) * fallen(way)", "min(law.b * k * x + way, MOST))",
      "test_bonds.py::test_extreme_force_scales"),
    M("Bell, way back: the clock goes on as if none had passed", "laws/barrier/bell.py",
      "clock * (1.0 - most / odds)", "clock", "test_bonds.py::test_lives_by_quadrature"),
    M("Bell: a force scale as if it were a length", "laws/barrier/bell.py",
      "stiffness * unit / thermal.force_scale", "unit / thermal.force_scale",
      "test_bonds.py::test_in_si_units"),
    M("catch-slip: pathways exchanged", "laws/barrier/catch_slip.py", "paths = thermal.slip, thermal.catch",
      "paths = thermal.catch, thermal.slip", "test_bonds.py::test_rupture_force_on_a_ramp"),
    M("catch-slip: ratio of forces upside down", "laws/barrier/catch_slip.py", "else force / p.force for",
      "else p.force / force for", "test_bonds.py::test_rupture_force_on_a_ramp"),
    M("catch-slip: the pathway that closes at the end of a step", "laws/barrier/catch_slip.py",
      "law.log_w + law.log_catch - catch * x)", "law.log_w + law.log_catch - catch * (x + length))",
      "test_bonds.py::test_lives_by_quadrature"),
    M("catch-slip: longest life of bonds that slip at any rate", "laws/barrier/catch_slip.py",
      "-law.log_w - law.log_slip - min(slope * y, MOST)", "-law.log_w - min(slope * y, MOST)",
      "test_bonds.py::test_lives_by_quadrature"),
    M("no thresholds: bonds end at ten force scales", "laws/no_thresholds.py", "BEYOND = 1000.0", "BEYOND = 10.0",
      "test_bonds.py::test_rupture_force_on_a_ramp"),
    M("newborn: a normal law of one side", "laws/newborn.py", "(z if u > 0.5 else -z)", "z",
      "test_newborn.py::test_births"),
    M("newborn: thresholds that are met at birth hold", "laws/newborn.py",
      "steps.size - search(steps, bound, True)", "steps.size - search(steps, bound, False)",
      "test_newborn.py::test_fractions_and_steps"),
    M("newborn: fractions have a unit", "laws/newborn.py", 'scale = 1.0 if self.of == "threshold" else unit',
      "scale = unit", "test_newborn_reference.py::test_units"),
    M("motors: stall forces of one sign", "engine/events.py",
      "net = math.copysign(drive.stall, speed) - _held(now)", "net = drive.stall - _held(now)",
      "test_events.py::test_a_motor_is_the_same_both_ways"),
    M("motors: a substrate stores nothing", "engine/events.py",
      "        now.work += 0.5 * drive.stiffness * (now.spring**2 - spring**2)\n", "",
      "test_events.py::test_energy"),
    M("events: delays from the beginning of the window", "engine/events.py",
      "contact.time_to_pinning = now.waited + delay", "contact.time_to_pinning = delay",
      "test_clusters.py::test_two_bonds_that_are_pinned_again_unstretched"),
    M("motors: brackets of steady velocities in another unit", "master/steady.py",
      "curve(ensemble, v * u).friction", "curve(ensemble, v).friction",
      "test_motors.py::test_several_steady_velocities"),
    M("lifetimes: each contact has the force of one in N", "master/lifetimes.py",
      "stretch = force / law.scale * (N / n)", "stretch = force / law.scale / n",
      "test_lifetimes.py::test_published_means_of_bell_bonds"),
    M("lifetimes: contacts hold beyond their threshold", "master/lifetimes.py",
      "np.where(stretch < xi, log_rate, math.inf)", "log_rate", "test_lifetimes.py::test_result_and_limits"),
    M("lifetimes: the way there and back do not add up", "master/lifetimes.py",
      "gain * (m + 2 * longer * t)", "gain * m",
      "test_lifetimes.py::test_survival_is_the_exponential_of_the_chain"),
    M("lifetimes: pinned contacts are pinned again", "master/lifetimes.py", "(N - n) / tau if again",
      "(N - n + 1.0) / tau if again", "test_lifetimes.py::test_published_means_of_bell_bonds"),
    M("lifetimes: those that were pinned again never leave", "master/lifetimes.py", "z = (p + u * psi) *",
      "z = (p + u) *", "test_lifetimes.py::test_survival_is_the_exponential_of_the_chain"),
    M("bursts: strength of a bundle in which none has broken", "master/bursts.py",
      "stretch * float(held[0]) * left, left)", "stretch * float(held[0]), left)",
      "test_bursts.py::test_tail_and_last_burst"),
    M("bursts: Borel's law with a follower more", "master/bursts.py", "special.xlogy(s - 1.0, a)",
      "special.xlogy(s, a)", "test_bursts.py::test_hemmer_and_hansen"),
    # laboratory
    M("materials: islands as wide as they are apart", "materials.py",
      "return self.spacing * self.shear_strength / self.gamma_c", "return self.spacing * self.shear_strength",
      "test_materials.py::test_yield_force_per_contact_and_b"),
    M("materials: an elastic length of one contact in a unit of area", "materials.py",
      "E / (self.contacts_per_area * self.stiffness)", "E / self.stiffness", "test_materials.py::test_parameters"),
    M("materials: a run file at the crossover of its temperature", "materials.py",
      "_decimal(material.crossover_velocity())", "_decimal(material.crossover_velocity(temperature))",
      "test_materials.py::test_friction_depends_on_the_temperature_of_run_files"),
    M("units: a load on the contacts that are simulated", "io/units.py", "ratio = force / interface.normal_load",
      "ratio = count * k / interface.normal_load", "test_units.py::test_what_is_known_of_which_interface"),
    M("units: a unit below the line multiplies", "io/units.py", "int(power or 1) * (-1 if below else 1)",
      "int(power or 1)", "test_units.py::test_a_machine_in_its_own_units"),
    M("units: a kT over the unit of energy", "io/units.py", "kT * size / constants.k", "kT / constants.k",
      "test_units.py::test_kelvin"),
    M("machine: as stiff as that of the run file, whatever kappa_s", "io/surface.py",
      "number * stiffness / stage['stiffness']", "number * stiffness",
      "test_units.py::test_a_machine_in_its_own_units"),
    M("surface: a friction coefficient of contacts that all are about to break", "io/surface.py",
      "mu = one.factor * 0.5 * mean", "mu = one.factor * mean",
      "test_units.py::test_what_is_assumed_of_a_surface_is_said"),
    M("fits: the likelihood of correlated errors without its determinant", "fitting/fit.py",
      "deviance += np.sum(np.log1p(-(problem.correlation**2)))", "deviance += 0.0",
      "test_record.py::test_likelihood_of_correlated_errors"),
    M("fits: priors are no measurements", "fitting/fit.py", "dof = n + problem.priors - k", "dof = n - k",
      "test_fit.py::test_priors"),
    M("fits: contacts of any stiffness", "fitting/fit.py", "density = scale / ensemble.stiffness * per_area",
      "density = scale * per_area", "test_fit.py::test_derived_contacts_per_area"),
    M("posterior: 90 % in the place of 95 %", "fitting/posterior.py", '"95": (0.025, 0.975)', '"95": (0.05, 0.95)',
      "test_posterior.py::test_shares_are_those_of_their_names"),
    M("posterior: all walkers are one", "fitting/posterior.py", "self.walkers * self.steps / self.autocorrelation",
      "self.steps / self.autocorrelation", "test_posterior.py::test_quantiles"),
    M("posterior: the square of the likelihood", "fitting/model.py", "return -0.5 * float(r @ r)",
      "return -float(r @ r)", "test_posterior.py::test_priors_and_bounds"),
    M("design: a variance for a standard deviation", "fitting/design.py",
      "math.sqrt(covariance(jacobian)[index, index])", "float(covariance(jacobian)[index, index])",
      "test_design.py::test_singular_directions_have_no_bound"),
    M("rate and state: slip without its logarithm of the state", "rate_and_state.py",
      "else -v * (log_v + log_theta)", "else -v * log_v",
      "test_rate_and_state.py::test_curve_is_that_of_a_taylor_series"),
    M("rate and state: radiation does not slow down", "rate_and_state.py", "/ (a + drag * v), growth",
      "/ a, growth", "test_rate_and_state.py::test_curve_is_that_of_radau"),
    M("rate and state: critical stiffness without the direct effect", "rate_and_state.py",
      "return (self.b - self.a) / self.D_c", "return self.b / self.D_c",
      "test_rate_and_state.py::test_sliding_is_stable_above_the_critical_stiffness"),
    M("rate and state: a - b has the sign of b - a", "fitting/rate_and_state.py",
      "for x in (difference, -difference)", "for x in (-difference, difference)",
      "test_rate_and_state.py::test_truth_is_recovered"),
    M("rate and state: b is a less their difference", "fitting/rate_and_state.py",
      "+ max(x, 0.0) for x in (difference, -difference)", "+ x for x in (0.0, -difference)",
      "test_rate_and_state.py::test_intervals_where_b_may_be_0"),
    M("records: what coarse steps miss is not made up for", "fitting/record.py",
      "return force + self.correction * largest,", "return force,",
      "test_record.py::test_prediction_is_the_mean_field"),
    M("records: what coarse steps miss where the force passes 0", "fitting/record.py",
      "largest = np.abs(coarse).max()", "largest = np.abs(coarse)",
      "test_record.py::test_forces_may_be_0"),
    M("records: a machine that is stiffer beside more contacts", "fitting/record.py",
      "stiffness=self.machine_stiffness / scale", "stiffness=self.machine_stiffness * scale",
      "test_record.py::test_machine_stiffness_is_that_of_the_stage"),
    M("records: points as if correlated once", "fitting/record.py", "1.0 + float(np.sum(worth))",
      "1.0 + float(np.sum(1.0 - rho))", "test_record.py::test_whitened_errors_are_independent"),
    M("records: points far apart make all independent", "fitting/record.py",
      "worth.mean() > _INDEPENDENT", "np.median(worth) > _INDEPENDENT",
      "test_record.py::test_neighbours_are_correlated_where_points_are_dense"),
    M("series: what no scatter shows averages out", "io/series.py",
      "np.sqrt(error**2 * 2.0**usable / rows + unseen)", "np.sqrt((error**2 * 2.0**usable + unseen) / rows)",
      "test_series.py::test_errors_that_scatter_does_not_show_stay"),
    M("series: slopes that noise makes", "io/series.py", "abs(best[0]) > 3.0 * cov[0, 0] ** 0.5",
      "abs(best[0]) > 0.0 * cov[0, 0]", "test_variants.py::test_steps_and_holds_are_told_from_noise"),
    M("load: contacts that are added are thinned by falls before", "model/load.py",
      "every = _trapezoid(change[nodes], grown) / level", "every = _trapezoid(change[nodes], grown)",
      "test_load.py::test_rates_by_closed_form"),
    M("load: a step up is thinned by falls before", "model/load.py", "more / level, more / level", "more, more",
      "test_load.py::test_a_step_up_after_one_down"),
    M("records: a drift about their start", "fitting/record.py", '"fit.drift": t - t.mean()', '"fit.drift": t - t[0]',
      "test_record.py::test_a_drift_is_told_from_the_middle_of_a_record"),
    M("records: errors of the shear stress", "fitting/record.py", "force / normal, errors / normal",
      "force / normal, errors", "test_variants.py::test_errors_are_divided_by_the_normal_stress"),
    M("load: the last interval counts as the first", "model/load.py",
      "0.5 * (np.append(0.0, steps)[:, None] + behind)", "0.5 * (np.append(steps, 0.0)[:, None] + behind)",
      "test_load.py::test_rates_by_closed_form"),
    M("stability: polynomials follow any growth within a panel of ages", "master/lives.py",
      "_STEEP = 8.0", "_STEEP = 1e9",
      "test_stability.py::test_perturbations_that_panels_of_ages_do_not_resolve"),
    M("stability: nodes follow any oscillation over a heavy tail", "master/characteristic.py",
      "_FOLLOWED = 6.0", "_FOLLOWED = 1e9", "test_stability.py::test_border_of_heavy_tails"),
    M("stability: the the scan ends between resonances of the edge of a law", "master/characteristic.py",
      "late = w >= 0.5 * high", "late = w >= 0.5 * (low + high)",
      "test_stability.py::test_border_of_heavy_tails"),
    M("stability: short delays still resonate where the scan ends", "master/characteristic.py",
      "weakening = max(weakening, edges / rising)", "pass",
      "test_stability.py::test_short_delays_resonate_with_both_edges_of_a_law"),
    M("stability: perturbations that coarser panels do not have", "master/stability.py",
      "missed < _SAME_ROOT * abs(p.real)", "missed < 1e9",
      "test_stability.py::test_perturbations_that_do_not_exist"),
    M("stability: growth per threshold of slip", "master/stability.py", "return mode(p * rate, OF",
      "return mode(p, OF", "test_stability.py::test_roots"),
    M("stability: the place of a slip in units of thresholds", "master/stability.py",
      "Estimate(X * unit, X_error * unit, 0)", "Estimate(X, X_error, 0)",
      "test_stability.py::test_fresh_slip_is_that_of_any_unit"),
    M("stability: verdicts on borders without their errors", "master/stability.py",
      "if abs(apart) <= _SURE * (border.stderr or 0.0):", "if abs(apart) <= 0.0:",
      "test_stability.py::test_a_verdict_that_errors_do_not_decide"),
    # contacts that are followed, steady averages and the mean field
    M("lanes: delays of both rounds alike", "engine/lanes.py",
      "delay_draw(law, uniform(words[2 * r, i], words[2 * r + 1, i]))",
      "delay_draw(law, uniform(words[0, i], words[1, i]))", "test_lives.py::test_side_by_side_as_one_by_one"),
    M("lanes: births are no part of the work", "engine/lanes.py",
      "return alone + stiffness * carried * lives.birth[r, i]", "return alone",
      "test_newborn.py::test_plain_births_and_small_births"),
    M("lanes: births of one sign, whatever the motion", "engine/lanes.py", "return Birth(xi, law.sign * y,",
      "return Birth(xi, y,", "test_newborn.py::test_time_steps_agree"),
    M("recorder: contacts of a varying stiffness stay pinned", "engine/recorder.py",
      "        recorder.deposits[end].count -= 1\n", "", "test_ramps.py::test_forces_that_are_no_ramps"),
    M("recorder: lives begin at the point before", "engine/recorder.py",
      "max(0, math.ceil(min(x * per_step, float(run.points))))",
      "max(0, math.floor(min(x * per_step, float(run.points))))", "test_ramps.py::test_single_deposits"),
    M("recorder: lives that join move the place of birth back", "engine/recorder.py",
      "fixed_narrow(broke[i] - born[i], -scales.force, narrow)",
      "fixed_narrow(broke[i] - born[i], scales.force, narrow)", "test_ramps.py::test_deposits_that_join"),
    M("steady: a variance without its drag", "engine/steady.py",
      "second = float((square.mean() + drag**2 * delay) / cycle.mean())",
      "second = float(square.mean() / cycle.mean())", "test_steady.py::test_variance_of_known_sums"),
    M("steady: a variance whose mean is known", "engine/steady.py",
      "of_variance = of_second - 2.0 * friction * of_friction", "of_variance = of_second",
      "test_steady.py::test_variance_of_known_sums"),
    M("steady: births do not respond to C", "engine/steady.py", "(rows[:, 1] - stretch / unit) / (1.0 - response[1])",
      "rows[:, 1] - stretch / unit", "test_steady.py::test_every_randomisation_has_its_own_fixed_point"),
    M("steady: plain rows share contacts", "engine/randomise.py", "PlainSums.empty(index * LANES, rounds,",
      "PlainSums.empty(index, rounds,", "test_lives.py::test_plain_error_bars_and_threads"),
    M("proposal: weights of another density", "engine/proposal.py", "weight[i] *= u[i] * e", "weight[i] *= u[i]",
      "test_steady.py::test_zero_temperature[1.0]"),
    M("sobol: recurrence of the third dimension", "numerics/sobol.py",
      "2 * m[2, k - 1] ^ 4 * m[2, k - 2] ^ m[2, k - 2]", "2 * m[2, k - 1] ^ 4 * m[2, k - 2]",
      "test_sobol.py::test_points_are_those_of_scipy"),
    M("sobol: scrambles without a diagonal", "numerics/sobol.py",
      "matrices * np.tri(_SOBOL_BITS, k=-1) + np.eye(_SOBOL_BITS)", "matrices * np.tri(_SOBOL_BITS)",
      "test_sobol.py::test_points_are_those_of_scipy"),
    M("master: a variance without its drag", "master/steady.py",
      "variance = square / cycle + drag**2 * (1.0 - pinned) - friction**2",
      "variance = square / cycle - friction**2", "test_newborn_reference.py::test_table"),
    M("slider: a stage of Radau's method", "master/slider.py", "a11 = damping + 1.5 * inertia + 5.0 / 12.0 * spring",
      "a11 = damping + 1.5 * inertia + spring / 3.0", "test_slider.py::test_motion_in_a_step"),
    M("motors: a stage as slow as at the end of a step twice", "master/slider.py",
      "slower = 0.5 * load * abs(", "slower = load * abs(", "test_forces_and_motors.py::test_motors"),
    M("forces: rates per time of the user", "master/slider.py", "rates = rates * pull.ends[-1]",
      "rates = rates * 1.0", "test_forces_and_motors.py::test_forces_up_and_down"),
    M("slider: a mass per time of the programme", "master/slider.py", "mass=stage.mass / time**2",
      "mass=stage.mass / time", "test_slider.py::test_agrees_with_the_mean_field[annealed, mass]"),
    M("cohorts: contacts that break in a step form again in it, whatever the delay", "master/cohorts.py",
      "later = max(dt - tau, 0.0)", "later = dt",
      "test_programme_reference.py::test_one_segment_is_a_constant_drive"),
    M("fronts: beyond its table W bends twice", "master/fronts.py",
      "(table[table.shape[0] - 1, 1] + 0.5 * beyond)", "(table[table.shape[0] - 1, 1] + beyond)",
      "test_fronts.py::test_share_that_is_broken"),
    M("fronts: W without Euler's constant", "master/fronts.py", "y + np.euler_gamma + special.exp1(z)",
      "y + special.exp1(z)", "test_fronts.py::test_second_integral"),
]
# fmt: on


class WrongTable(Exception):
    """A mistake that cannot be made, or tests that fail without it."""


def pattern(quote: str) -> re.Pattern[str]:
    """Match a quote of source code however the formatter breaks its lines."""
    tokens = re.findall(r"\w+|[^\w\s]", quote)
    gaps = [r",?\s*" if token in ")]}" else r"\s*" for token in tokens[1:]]
    parts = [
        gap + re.escape(token) for gap, token in zip(gaps, tokens[1:], strict=True)
    ]
    return re.compile(re.escape(tokens[0]) + "".join(parts))


def changed(mistake: Mistake, root: Path = ROOT) -> str:
    """The source with the mistake. Raises WrongTable."""
    source = (root / "eqsim" / mistake.file).read_text(encoding="utf-8")
    indent = mistake.old[: len(mistake.old) - len(mistake.old.lstrip())]
    new = mistake.new.removeprefix(indent).rstrip()
    found, count = pattern(mistake.old).subn(lambda _: new, source)
    if count != 1:
        raise WrongTable(
            f"{mistake.name}: its text occurs {count} times in {mistake.file}, must be once"
        )
    try:
        ast.parse(found)
    except SyntaxError as error:
        raise WrongTable(f"{mistake.name}: is no Python ({error})") from None
    return found


@functools.cache
def imports(file: ast.Module) -> list[tuple[str, str]]:
    """The full names of all that a file imports, and what it calls them."""
    found = []
    for node in ast.walk(file):
        if isinstance(node, ast.Import):
            found += [
                (alias.name, alias.asname or alias.name.partition(".")[0])
                for alias in node.names
            ]
        elif isinstance(node, ast.ImportFrom):
            found += [
                (f"{node.module}.{alias.name}", alias.asname or alias.name)
                for alias in node.names
            ]
    return found


def compilers(file: ast.Module, modules: tuple[str, ...] = COMPILERS) -> set[str]:
    """The names in a file for modules that compile, and for what it imports from them."""
    within = tuple(f"{module}." for module in modules)
    return {name for path, name in imports(file) if f"{path}.".startswith(within)}


def is_compiled(function: ast.FunctionDef, known: set[str]) -> bool:
    """Whether a function may become machine code: by a decorator with one of the names
    of `compilers`, or as the body that a law registers for a kernel routine."""
    for decorator in function.decorator_list:
        names = {node.id for node in ast.walk(decorator) if isinstance(node, ast.Name)}
        maker = decorator.func if isinstance(decorator, ast.Call) else decorator
        if names & known or (
            isinstance(maker, ast.Attribute) and maker.attr == "register"
        ):
            return True
    return False


def needs_kernels(mistake: Mistake, root: Path = ROOT) -> bool:
    """Whether compiled code may change: unless the mistake is in a function of plain
    Python, in a file that does not itself speak to the compiler."""
    source = (root / "eqsim" / mistake.file).read_text(encoding="utf-8")
    place = pattern(mistake.old).search(source)
    line = source.count("\n", 0, place.start() if place else 0) + 1
    file = ast.parse(source)
    functions = [node for node in ast.walk(file) if isinstance(node, ast.FunctionDef)]
    around = [
        node for node in functions if node.lineno <= line <= (node.end_lineno or 0)
    ]
    if not around or compilers(file, ("numba", "llvmlite")):
        return True
    return any(is_compiled(node, compilers(file)) for node in around)


class Copy:
    """A copy of the repository in which one mistake at a time is made."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "eqsim"
        shutil.copytree(
            ROOT,
            self.root,
            ignore=shutil.ignore_patterns(".git", "__pycache__", "out", ".*_cache"),
        )
        self.environment = os.environ | {
            "PYTHONPATH": str(self.root),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        self.known = self.kernels()

    def kernels(self) -> Path:
        """Where the kernels of the code as it stands are kept."""
        command = [
            sys.executable,
            "-c",
            "from eqsim.numerics.kernel_folder import kernel_folder; print(kernel_folder())",
        ]
        done = subprocess.run(
            command,
            cwd=self.root,
            env=self.environment,
            capture_output=True,
            text=True,
            check=True,
        )
        return Path(done.stdout.strip())

    def pytest(self, *arguments: str) -> tuple[int, str]:
        """Exit code and output; -1 if it had to be ended."""
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-x",
            "-q",
            "-rfE",
            "-p",
            "no:cacheprovider",
            *arguments,
        ]
        process = subprocess.Popen(
            command, cwd=self.root, env=self.environment, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        try:
            output, _ = process.communicate(timeout=LONGEST)
            return process.returncode, output
        except subprocess.TimeoutExpired:
            return -1, ""
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()

    def judge(self, mistake: Mistake, whole: bool) -> tuple[str, str]:
        """The fate of a mistake, and by what."""
        path, kept = self.root / "eqsim" / mistake.file, None
        source, times = path.read_bytes(), path.stat()
        compiled = needs_kernels(mistake, self.root)
        path.write_text(changed(mistake, self.root), encoding="utf-8")
        try:
            if (
                folder := self.kernels()
            ) != self.known:  # its name tells the sources of kernels apart
                kept = folder
                if not compiled:
                    shutil.copytree(self.known, kept, dirs_exist_ok=True)
            for arguments in (nearest([mistake]), *([[]] if whole else [])):
                code, output = self.pytest(*arguments)
                if code == -1:
                    return "caught", f"no end within {LONGEST:g} s"
                if code in (4, 5):
                    raise WrongTable(
                        f"{mistake.name}: pytest finds no such tests\n{output[-2000:]}"
                    )
                if code:
                    test = re.search(
                        r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", output, re.MULTILINE
                    )
                    said = re.search(r"^E  +(.+)$", output, re.MULTILINE)
                    return (
                        "caught",
                        f"{test[1] if test else 'pytest'} ({said[1][:100] if said else code})",
                    )
            return "SURVIVED", ""
        finally:
            path.write_bytes(source)
            # kernels of this file are still known
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
            if kept:
                shutil.rmtree(kept, ignore_errors=True)


def path_of(test: str) -> str:
    """A test from the root of the repository, whose file is given by its name alone."""
    file, colons, name = test.partition("::")
    (path,) = (ROOT / "tests").rglob(file)
    return f"{path.relative_to(ROOT)}{colons}{name}"


def ids(mistakes: list[Mistake]) -> list[str]:
    """The tests nearest to some mistakes, as pytest wants them."""
    return list(
        dict.fromkeys(
            path_of(test)
            for mistake in mistakes
            for test in mistake.tests.split(" & ")
            if test
        )
    )


def nearest(mistakes: list[Mistake]) -> list[str]:
    """Arguments for pytest: the tests nearest to some mistakes, with all their cases,
    in one process."""
    return ["-n", "0", "-m", "not long", *ids(mistakes)]


def run(mistakes: list[Mistake], whole: bool) -> list[Fate]:
    """Make one mistake after the other. Raises WrongTable."""
    fates = [
        Fate(mistake.name, "equivalent", mistake.same, 0.0)
        for mistake in mistakes
        if mistake.same
    ]
    left = [mistake for mistake in mistakes if not mistake.same]
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        print(f"{len(ids(left))} tests without a mistake", flush=True)
        code, output = copy.pytest(*nearest(left))
        if code:
            raise WrongTable(f"without a mistake:\n{output[-3000:]}")
        for number, mistake in enumerate(left, 1):
            begin = time.monotonic()
            fate, by = copy.judge(mistake, whole)
            fates.append(Fate(mistake.name, fate, by, time.monotonic() - begin))
            print(
                f"{number} of {len(left)}: {mistake.name}: {fate} {by} [{fates[-1].seconds:.0f} s]",
                flush=True,
            )
    return fates


def main() -> int:
    parser = argparse.ArgumentParser(
        description="Deliberate mistakes, one at a time: does a test notice?"
    )
    parser.add_argument(
        "--list",
        action="store_true",
        help="only check that every mistake can be made, and name it",
    )
    parser.add_argument(
        "--only",
        nargs="+",
        default=[""],
        metavar="PART",
        help="those whose names hold one of these",
    )
    parser.add_argument(
        "--whole",
        action="store_true",
        help="run the default suite where the nearest tests pass",
    )
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write the result there, too"
    )
    given = parser.parse_args()
    chosen = [
        mistake
        for mistake in MISTAKES
        if any(part in mistake.name for part in given.only)
    ]
    try:
        if len({mistake.name for mistake in MISTAKES}) < len(MISTAKES):
            raise WrongTable("two mistakes have the same name")
        for mistake in MISTAKES:
            changed(mistake)
        if given.list:
            print("\n".join(f"{mistake.name} ({mistake.file})" for mistake in chosen))
            return 0
        fates = run(chosen, given.whole)
    except WrongTable as error:
        print(f"mutations.py: {error}", file=sys.stderr)
        return 2
    if given.json:
        given.json.write_text(
            json.dumps([fate._asdict() for fate in fates], indent=1) + "\n",
            encoding="utf-8",
        )
    print("\n| mistake | fate | by |\n|---|---|---|")
    for fate in fates:
        print(f"| {fate.name} | {fate.fate} | {fate.by} |")
    survivors = sum(fate.fate == "SURVIVED" for fate in fates)
    print(f"\n{len(fates)} mistakes, {survivors} survived")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
