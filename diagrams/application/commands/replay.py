"""`slipmap replay`: a log of messages through perception and identification."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.commands.cell_run import (
    folder_option,
    leave,
    scenario_of,
    scenario_option,
    show_files,
)
from slipmap.diagrams.application.commands.record import shown_lag
from slipmap.diagrams.application.outputs import check_output, make_folder
from slipmap.diagrams.application.terminal import Progress, note, prepare_kernels, status
from slipmap.models.files import BadInput, write_json

if TYPE_CHECKING:
    from slipmap.diagrams.loops.push_listener import PushListener


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@scenario_option
@folder_option("replay")
@options.hypotheses_option
@options.seed_option
@options.json_in_folder_option
def replay(
    log: Path, scenario_file: Path | None, folder: Path, hypotheses: int, seed: int, json_file: Path | None
) -> None:
    """Find the pushes in a log of LCM, and learn from them.

    LOG is what `slipmap record --log` or LCM's `lcm-logger` wrote. It is gone through as fast as it can be,
    by the senders' stamps, as if the cell were running. Leaves what `slipmap explore` leaves, and tells by
    how much the camera is late.
    """
    from slipmap.diagrams.application.commands.identify import show
    from slipmap.diagrams.loops.push_listener import PushListener, listened_json, why_none
    from slipmap.diagrams.loops.run_folder import refuse_robots_pushes

    scenario = scenario_of(scenario_file, None)
    make_folder(folder)
    refuse_robots_pushes(folder, "--out")
    if json_file is not None:
        check_output(json_file)
    listener = PushListener(scenario, log.stem)
    _listen(log, listener, folder)
    if not listener.pushes:
        raise BadInput(f"{log}: holds no push: {why_none(listener)}")
    dataset = listener.dataset()
    prepare_kernels()
    with Progress() as progress:
        from slipmap.models.inference.identification import identify

        identification = identify(dataset, hypotheses=hypotheses, seed=seed, progress=progress)
    written = leave(identification, dataset, folder)
    show(identification, dataset)
    lag = shown_lag(dataset)
    if json_file is not None:
        found = {**listened_json(listener), "camera_lag": None if lag is None else lag.to_json()}
        write_json(json_file, {**identification.to_json(), "heard": found})
    show_files(written)


def _listen(log: Path, listener: PushListener, folder: Path) -> None:
    from slipmap.diagrams.hardware.message_stream import BadLog, LogReader
    from slipmap.diagrams.loops.push_listener import hearing, record_pushes
    from slipmap.diagrams.loops.run_folder import PUSHES
    from slipmap.models.measurements.writing import PushRecorder

    try:
        with open(log, "rb") as file:
            reader = LogReader(file, str(log))
            record_pushes(reader, listener, PushRecorder(folder / PUSHES), status)
    except OSError as error:
        raise BadInput(f"{log}: cannot be read ({error.strerror})") from error
    except BadLog as error:
        raise BadInput(str(error)) from error
    status(hearing(listener))
    if reader.cut_off:
        note(f"warning: {log} ends in the midst of a message; what comes before is used")
