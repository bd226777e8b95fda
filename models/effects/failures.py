"""What goes wrong in the code of effects, told with the file and the line in it."""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from models.effects.effect import Effect

LONGEST = 400
"""Characters of what an error in an effect's code may say."""


class EffectError(ValueError):
    """An effect that cannot be used; the message names the effect, and file and line where known."""


def failing_line(error: BaseException) -> str:
    """`file, line n` of the innermost frame of an error that is outside this package and its libraries."""
    frames = traceback.extract_tb(error.__traceback__)
    here = Path(__file__).parent
    for frame in reversed(frames):
        path = Path(frame.filename)
        if frame.filename.startswith("<"):  # of Python itself, as "<frozen _sitebuiltins>"
            continue
        if "site-packages" not in path.parts and (path.parent != here or path.name == "library.py"):
            return f"{path.name}, line {frame.lineno}"
    return "unknown place"


def told(error: BaseException) -> str:
    """Where and with what an effect's code failed."""
    try:
        said = " ".join(str(error).split())
    except Exception:  # an error of the user's own may fail to tell itself
        said = "no text"
    said = said if len(said) <= LONGEST else f"{said[: LONGEST - 3]}..."
    return f"{failing_line(error)}: {type(error).__name__}: {said}"


def call_formula(effect: Effect, method: str, *arguments: Any) -> Any:
    """Result of one of the effect's methods.

    Raises:
        EffectError: it raised, or wanted to end the program; names the effect, the method, file and line.
    """
    try:
        return getattr(effect, method)(*arguments)
    except (EffectError, KeyboardInterrupt):
        raise
    except BaseException as error:  # as by sys.exit(), which would end the program without a word
        raise EffectError(f"effect {effect.name}: {method}() failed in {told(error)}") from error
