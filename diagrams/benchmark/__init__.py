"""Benchmark: the compiled rollout beside plain numpy, MuJoCo and Bullet."""

from diagrams.benchmark.comparison import run_benchmark
from diagrams.benchmark.table import format_table

__all__ = ["format_table", "run_benchmark"]
