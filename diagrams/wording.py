"""Words that tables and pictures share."""

ROLES = {"fit": "fit", "heldout": "held out"}
"""What people read for the role of a push."""


def short_name(trial: str) -> str:
    """`trials/003.json` as `003`; a long name keeps its end, which tells it from others."""
    name = trial.rsplit("/", 1)[-1].rsplit(".", 1)[0]
    return name if len(name) <= 24 else "…" + name[-23:]
