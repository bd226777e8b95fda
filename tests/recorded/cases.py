"""The command lines whose outputs are recorded.

All run in one folder, which `inputs.py` begins; a case that reads what others wrote names them in `after`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

COMMANDS = (
    "doctor",
    "demo",
    "example",
    "explore",
    "pregrasp",
    "station",
    "record",
    "replay",
    "object",
    "identify",
    "predict",
    "view",
    "compare",
    "diagnose",
    "fit",
    "effects",
    "calibrate",
    "explore-study",
    "campaign",
    "blind-test",
    "bench",
    "completion",
)


@dataclass(frozen=True)
class Case:
    """One command line.

    Attributes:
        line: what follows the word `slipmap`.
        after: names of cases that write what this one reads.
        environment: variables that are set besides.
        renders: whether it takes pictures, which not every machine can.
    """

    line: str
    after: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    renders: bool = False


_HELP = {
    "help": Case("--help"),
    "help-short": Case("-h"),
    "no-command": Case(""),
    "version": Case("--version"),
    **{f"help-{command}": Case(f"{command} --help") for command in COMMANDS},
}

_REFUSALS = {
    # of the command line
    "refused-unknown-command": Case("identfy pushes"),
    "refused-command-like-no-other": Case("xyzzy"),
    "refused-unknown-option": Case("identify pushes --hypothesis 3 -o belief.npz"),
    "refused-option-twice": Case("identify pushes --seed 1 --seed 2 -o belief.npz"),
    "refused-empty-name": Case("identify '' -o belief.npz"),
    "refused-choice": Case("identify pushes --method papr -o belief.npz"),
    "refused-range": Case("identify pushes --hypotheses 1 -o belief.npz"),
    "refused-seed": Case("demo --seed -1"),
    "refused-missing-option": Case("identify pushes"),
    "refused-missing-argument": Case("predict --belief belief.npz"),
    "refused-ending": Case("identify pushes -o belief.txt"),
    "refused-missing-folder": Case("identify pushes -o nowhere/belief.npz"),
    "refused-output-is-folder": Case("identify pushes -o broken"),
    "refused-same-file-twice": Case("effects --picture same.png --json same.png"),
    "refused-written-over": Case("identify push.csv --object rect1 -o belief.npz --json push.csv"),
    # of files
    "refused-no-dataset": Case("identify nowhere -o belief.npz"),
    "refused-broken-dataset": Case("identify broken -o belief.npz"),
    "refused-dataset-without-format": Case("diagnose formless"),
    "refused-csv-without-object": Case("identify push.csv -o belief.npz"),
    "refused-csv-without-columns": Case("compare push.csv --object rect1"),
    "refused-unknown-shape": Case("fit push.csv --object rect9 --effect table_tilt -o tilt.npz"),
    "refused-no-belief": Case("predict nowhere --belief nothing.npz"),
    "refused-bad-belief": Case("view bad.npz --html view.html"),
    "refused-no-mesh": Case("object mug.obj -o mug.yaml --finger 0.008"),
    "refused-large-mesh": Case("object block.stl -o block.yaml --finger 0.008"),
    "refused-picture-without-scale": Case("object photo.png -o photo.yaml --finger 0.008"),
    "refused-foreign-folder": Case("demo -o taken"),
    "refused-effect-file": Case("effects --effect-file bad_effect.py"),
    "refused-no-effect-file": Case("effects --effect-file nothing.py"),
    "refused-no-log": Case("replay nothing.lcmlog"),
    "refused-bad-log": Case("replay bad.lcmlog"),
    "refused-no-scenario": Case("station --scenario nothing.yaml"),
    "refused-bad-scenario": Case("explore --scenario cell.yaml"),
    "refused-yaml": Case("pregrasp --scenario broken/dataset.yaml"),
    "refused-no-run": Case("explore --resume nothing"),
    # of what is asked for
    "refused-unknown-effect": Case("fit nowhere --effect table_tild -o tilt.npz"),
    "refused-effect-to-explain": Case("effects teter"),
    "refused-belief-beside-effect": Case("compare nowhere --belief belief.npz --effect table_tilt"),
    "refused-object": Case("explore --object hamer"),
    "refused-object-of-study": Case("explore-study --object hamer --runs 1"),
    "refused-no-pushes": Case("explore --pushes 0"),
    "refused-no-pushes-to-grasp": Case("pregrasp --pushes 0"),
    "refused-hypotheses-of-replay": Case("replay bad.lcmlog --hypotheses 1"),
    "refused-finger": Case("object block.stl -o block.yaml --finger 0"),
    "refused-resume-with-seed": Case("explore --resume nothing --seed 3"),
    "refused-true-method": Case("pregrasp --method true --hardware"),
    "refused-address": Case("station --lcm nonsense"),
    "refused-address-to-record": Case("record -o recorded --lcm nonsense"),
    "refused-object-of-campaign": Case("campaign fig5 --objects hamer"),
    "refused-methods-of-campaign": Case("campaign fig5 --objects hammer --methods true"),
    "refused-method-of-campaign": Case("campaign fig6 --objects hammer --methods tru"),
    "refused-experiment": Case("campaign fig8"),
    "refused-maps-of-several": Case("fit one two --effect table_tilt --maps maps.yaml -o tilt.npz"),
    "refused-apart-of-one": Case("compare nowhere --apart table"),
    "refused-draws": Case("diagnose nowhere --draws 3"),
    "refused-number-of-objects": Case("calibrate --objects none"),
    "refused-shell": Case("completion tcsh"),
    "refused-jobs": Case("blind-test --jobs 0"),
    "refused-argument-of-bench": Case("bench now"),
}

_RUNS = {
    "demo": Case("demo -o demo --fit-pushes 3 --heldout-pushes 2 --seed 3 --json demo.json"),
    "identify": Case("identify demo/pushes -o belief.npz --hypotheses 4 --json identify.json", ("demo",)),
    "identify-plain": Case(
        "identify demo/pushes -o plain.npz --plain --hypotheses 4 --seed 7 --json plain.json", ("demo",)
    ),
    "identify-few": Case(
        "identify demo/pushes -o few.npz --plain --fit-pushes 1 --hypotheses 3 --pictures pictures", ("demo",)
    ),
    "identify-too-few": Case("identify demo/pushes -o none.npz --fit-pushes 9", ("demo",)),
    "identify-paper": Case(
        "identify demo/pushes -o paper.npz --method paper --fit-pushes 1 --hypotheses 2 --json paper.json",
        ("demo",),
    ),
    "predict": Case(
        "predict demo/pushes --belief plain.npz -o predictions.png --json predict.json", ("identify-plain",)
    ),
    "predict-with-effect": Case(
        "predict demo/pushes --belief tilt.npz -o tilt-predictions.png --json predict-tilt.json", ("fit",)
    ),
    "compare": Case("compare demo/pushes -o learned.html --seed 2 --json learned.json", ("demo",)),
    "compare-belief": Case(
        "compare demo/pushes --belief plain.npz -o comparison.html --json compare.json", ("identify-plain",)
    ),
    "compare-effect": Case(
        "compare demo/pushes --effect table_tilt -o both.html --json both.json", ("demo",)
    ),
    "fit": Case(
        "fit demo/pushes --effect table_tilt -o tilt.npz --hypotheses 4 --seed 1 --json fit.json", ("demo",)
    ),
    "diagnose": Case(
        "diagnose demo/pushes --quick --draws 99 --seed 2 -o diagnosis.html --json diagnose.json", ("demo",)
    ),
    "view": Case("view plain.npz --html view.html", ("identify-plain",)),
    "effects": Case("effects --json effects.json"),
    "effect-tilt": Case("effects table_tilt --json table-tilt.json"),
    "effect-tether": Case("effects tether --picture tether.png --json tether.json"),
    "effect-loose-mass": Case("effects loose_mass"),
    "effects-with-own": Case("effects --effect-file magnet.py"),
    "effect-of-own": Case("effects magnet --effect-file magnet.py --json magnet.json"),
    "object-mesh": Case(
        "object block.stl -o block.yaml --finger 0.006 --metres-per-unit 0.001 --mass 0.8 --cells 24"
    ),
    "object-picture": Case(
        "object photo.png -o photo.yaml --finger 0.006 --metres-per-pixel 0.001 --cells 30"
    ),
    "identify-csv": Case(
        "identify block.csv --object block.yaml -o block.npz --plain --hypotheses 2 --json block.json",
        ("object-mesh",),
    ),
    "calibrate": Case("calibrate --objects 1 --seed 1 -o curves.png --json calibrate.json"),
    "campaign-goals": Case(
        "campaign fig5 --objects snack --trials 1 --workers 1 -o campaign --json goals.json"
    ),
    "completion-bash": Case("completion bash"),
    "completion-zsh": Case("completion zsh"),
    "completion-fish": Case("completion fish"),
    "completed-commands": Case(
        "", (), {"_SLIPMAP_COMPLETE": "bash_complete", "COMP_WORDS": "slipmap ", "COMP_CWORD": "1"}
    ),
    "completed-effects": Case(
        "",
        (),
        {
            "_SLIPMAP_COMPLETE": "bash_complete",
            "COMP_WORDS": "slipmap fit pushes --effect t",
            "COMP_CWORD": "4",
        },
    ),
    "doctor": Case("doctor --json doctor.json", renders=True),
    "explore": Case(
        "explore --object box --pushes 1 --checks 0 -o exploration --json explore.json", renders=True
    ),
    "explore-study": Case(
        "explore-study --object snack --runs 1 --pushes 1 --checks 1 -o study --json study.json", renders=True
    ),
}

CASES = {**_HELP, **_REFUSALS, **_RUNS}
