"""How the memory of a process grows over many explorations: `python -m tests.diagrams.measure_memory [RUNS]`.

Each run is a loop of its own: station, arm, camera with noise, one push, learning. They differ in their seed.
"""

from __future__ import annotations

import sys

from slipmap.diagrams.loops.exploration_loop import LoopOptions
from slipmap.diagrams.loops.exploration_run import explore
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.testing.cell import small_scenario

RUNS = 100


def resident() -> float:
    """Memory of this process, MB."""
    with open("/proc/self/status") as status:
        (line,) = (line for line in status if line.startswith("VmRSS"))
    return float(line.split()[1]) * 1024 / 1e6


def measured(runs: int, scenario: Scenario) -> list[float]:
    """Memory after each run, MB."""
    memory = []
    for seed in range(runs):
        run = explore(scenario, LoopOptions(pushes=1, cells=30, hypotheses=4, strategy="random", seed=seed))
        memory.append(resident())
        done = f"{run.simulated:.1f} s simulated in {run.seconds:.1f} s"
        print(f"run {seed + 1} of {runs}: {memory[-1]:.0f} MB, {done}", flush=True)
    return memory


def main() -> None:
    """Run as many explorations as told."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else RUNS
    memory = measured(runs, small_scenario("lockstep"))
    print(f"grown by {max(memory) - memory[0]:.0f} MB since the first run")


if __name__ == "__main__":
    main()
