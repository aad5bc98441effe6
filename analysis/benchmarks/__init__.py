"""Throughput of eqsim against what one would write without it, as ratios within one
run."""
