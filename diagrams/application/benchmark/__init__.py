"""Benchmark: the compiled rollout beside plain numpy, MuJoCo and Bullet."""

from slipmap.diagrams.application.benchmark.side_by_side import format_table, run_benchmark
