"""`slipmap record`: pushes of a cell that somebody else drives, as a dataset."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.commands.cell_run import lcm_option, scenario_of, scenario_option
from slipmap.diagrams.application.outputs import check_folder, check_output
from slipmap.diagrams.application.terminal import Progress, note, paragraph, prepare_kernels, status
from slipmap.models.files import BadInput, write_json, writing

if TYPE_CHECKING:
    from slipmap.models.inference.camera_lag import CameraLag
    from slipmap.models.measurements import PushDataset


@click.command()
@lcm_option
@scenario_option
@options.path_option(
    "-o", "--output", required=True, metavar="DATASET",
    about="Folder for the dataset; there must be none yet.",
)  # fmt: skip
@options.path_option(
    "--log", "log_file",
    about="Write all messages as they come to an LCM log, for `slipmap replay`; there must be none yet.",
)  # fmt: skip
@options.count_option("--pushes", about="End by itself after N pushes.")
@options.json_option
def record(
    url: str,
    scenario_file: Path | None,
    output: Path,
    log_file: Path | None,
    pushes: int | None,
    json_file: Path | None,
) -> None:
    """Record the pushes in a robot's cell, whoever makes them.

    Listens to the messages of a running cell, real or of `slipmap station`, and sends none. Each push is
    written as soon as the object was seen at rest after it: of the finger, down beside the object, that moved
    it. Every fourth push is held out to judge by. It runs until Ctrl-C, and then tells by how much the camera
    is late.
    """
    from slipmap.diagrams.hardware.channels import GRIPPER_COMMAND, IIWA_COMMAND, HardwareError
    from slipmap.diagrams.hardware.message_stream import MessageStream
    from slipmap.diagrams.loops.push_listener import (
        HEARD,
        PushListener,
        hearing,
        listened_json,
        record_pushes,
        why_none,
    )
    from slipmap.models.measurements.writing import PushRecorder, is_replaced

    scenario = scenario_of(scenario_file, None)
    check_folder(output.resolve().parent, output)
    is_replaced(output.resolve(), overwrite=False)
    listener = PushListener(scenario, output.resolve().name)
    with ExitStack() as stack:
        log = None if log_file is None else stack.enter_context(_new_log(log_file))
        commands = (IIWA_COMMAND, GRIPPER_COMMAND) if log_file is not None else ()
        try:
            stream = MessageStream(url, [*HEARD, *commands])
            stack.callback(stream.close)
            note(f"listening at {url}; Ctrl-C ends it")
            with _until_stopped() as stopped:
                record_pushes(
                    stream, listener, PushRecorder(output), status, log=log, most=pushes, stopped=stopped
                )
        except HardwareError as error:
            raise BadInput(str(error)) from error
    status(hearing(listener))
    lag = None
    if listener.pushes:
        dataset = listener.dataset()
        lag = shown_lag(dataset)
        note(f"pushes: {output}")
    if log_file is not None:
        note(f"messages: {log_file}")
    if json_file is not None:
        write_json(
            json_file, {**listened_json(listener), "camera_lag": None if lag is None else lag.to_json()}
        )
    if not listener.pushes:
        raise click.ClickException(f"no push was recorded: {why_none(listener)}")


def shown_lag(dataset: PushDataset) -> CameraLag | None:
    """How late the camera is, told on stdout; None where the pushes cannot tell, or at Ctrl-C."""
    from slipmap.models.inference.camera_lag import camera_lag

    prepare_kernels()
    try:
        with Progress() as progress:
            lag = camera_lag(dataset, progress=progress)
    except KeyboardInterrupt:
        return None
    paragraph(_lag_words(lag))
    return lag


def _lag_words(lag: CameraLag | None) -> str:
    """What is known of the camera's lag, in a sentence or two."""
    if lag is None:
        return "Camera: the pushes cannot tell whether it is late; the object was not seen while it moved."
    value, low, high = (1e3 * number for number in (lag.value, lag.low, lag.high))
    numbers = f"{low:.0f} to {high:.0f} ms, from {lag.pushes} push{'es' * (lag.pushes > 1)}"
    if not lag.shown:
        return f"Camera: no lag beside the arm is to be seen ({numbers})."
    which = "late" if value > 0 else "early"
    return (
        f"Camera: its pictures are {abs(value):.0f} ms {which} beside the arm ({numbers}). See to the clocks"
        " of their drivers, or learn with it: `slipmap fit --effect sensor_latency`."
    )


@contextmanager
def _new_log(path: Path) -> Iterator[BinaryIO]:
    check_output(path)
    if path.exists():
        raise BadInput(f"{path}: is there already; choose another name")
    with writing(path), open(path, "xb") as file:
        yield file


@contextmanager
def _until_stopped() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C was pressed, or the process asked to end; a second time ends it at once."""
    asked: list[int] = []

    def ask(number: int, frame: object) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
