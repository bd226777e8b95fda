"""Command lines whose output is recorded, in the order in which they run: later ones read what earlier wrote."""

from __future__ import annotations

COMMANDS = (
    "doctor demo explore pregrasp station record replay object identify predict view compare diagnose fit"
    " effects calibrate explore-study campaign blind-test bench completion"
).split()

CASES: dict[str, str] = {
    "no-command": "",
    "help": "--help",
    **{f"help-{command}": f"{command} --help" for command in COMMANDS},
    "no-such-command": "identfy pushes",
    "no-such-option": "identify simulated --hypothesis 3 -o belief.npz",
    "no-such-choice": "identify simulated --method papr -o belief.npz",
    "twice": "identify simulated --seed 1 --seed 2 -o belief.npz",
    "no-dataset": "identify nowhere -o belief.npz",
    "no-output": "identify nowhere",
    "output-is-no-belief": "identify nowhere -o belief.txt",
    "out-of-range": "identify nowhere -o belief.npz --hypotheses 1",
    "no-belief": "predict simulated/pushes --belief nothing.npz",
    "no-mesh": "object mug.obj -o mug.yaml --finger 0.008",
    "no-such-effect": "fit simulated/pushes --effect table_tild -o tilt.npz",
    "no-such-object": "explore --object hamer",
    "no-scenario": "station --scenario nothing.yaml",
    "no-log": "replay nothing.log",
    "no-run-to-resume": "explore --resume nothing",
    "no-such-experiment": "campaign fig8",
    "no-such-shell": "completion tcsh",
    "demo": "demo -o simulated --fit-pushes 3 --heldout-pushes 2 --seed 3 --json demo.json",
    "demo-again": "demo -o simulated --fit-pushes 3 --heldout-pushes 2 --seed 3",
    "identify": "identify simulated/pushes -o belief.npz --hypotheses 4 --seed 5 --json identify.json",
    "identify-plain": "identify simulated/pushes -o plain.npz --plain --fit-pushes 2 --hypotheses 4"
    " --json identify-plain.json",
    "identify-too-few": "identify simulated/pushes -o plain.npz --fit-pushes 9",
    "predict": "predict simulated/pushes --belief belief.npz -o predictions.png --json predict.json",
    "compare": "compare simulated/pushes --belief belief.npz -o comparison.html --json compare.json",
    "compare-both": "compare simulated/pushes --belief belief.npz --effect table_tilt -o comparison.html",
    "fit": "fit simulated/pushes --effect table_tilt -o tilt.npz --hypotheses 4 --seed 1 --json fit.json",
    "predict-tilt": "predict simulated/pushes --belief tilt.npz -o tilt.png --json predict-tilt.json",
    "diagnose": "diagnose simulated/pushes --quick --draws 99 --seed 2 --json diagnose.json",
    "view": "view belief.npz --html view.html",
    "effects": "effects --json effects.json",
    "effect": "effects tether --json tether.json",
    "no-such-effect-explained": "effects teter",
    "completion": "completion bash",
}
"""By name: the arguments, blanks between them. The working folder is a fresh one, shared by all."""
