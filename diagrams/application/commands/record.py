"""`slipmap record`, `slipmap replay` and `slipmap station`: pushes from the messages of a robot's cell.

`record` finds pushes that someone else makes among the messages of a running cell, `replay` finds them in a
log and learns from them, and `station` simulates a cell with the messages of a real one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.commands import cell_run, options
from slipmap.diagrams.application.outputs import check_folder, check_output, take_folder
from slipmap.diagrams.application.terminal import Progress, counted, note, paragraph, prepare_kernels, status
from slipmap.models.files import BadInput, all_or_nothing, write_json, writing

if TYPE_CHECKING:
    from slipmap.diagrams.hardware.mcap_log import McapLog
    from slipmap.diagrams.hardware.message_stream import LcmLog
    from slipmap.diagrams.loops.push_listener import PushListener
    from slipmap.models.inference.camera_lag import CameraLag
    from slipmap.models.measurements import PushDataset

MCAP_ENDING = ".mcap"


@click.command()
@cell_run.lcm_option
@cell_run.scenario_option
@options.path_option(
    "-o", "--output", required=True, metavar="DATASET",
    about="Folder for the dataset; it must not hold one yet.",
)  # fmt: skip
@options.path_option(
    "--log", "log_file",
    about="Write all messages as received to an LCM log, for `slipmap replay`, or to an MCAP file (.mcap),"
    " which viewers open too; the file must not exist yet.",
)  # fmt: skip
@options.count_option("--pushes", about="Stop after N pushes.")
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

    Listens to the messages of a running cell, real or simulated by `slipmap station`, and sends none. Writes
    a push as soon as the object, moved by the lowered finger, is seen at rest again. Every fourth push is
    held out. Runs until Ctrl-C, and then reports the latency of the camera.
    """
    from slipmap.diagrams.hardware.control import until_ctrl_c
    from slipmap.diagrams.hardware.message_stream import MessageStream
    from slipmap.diagrams.hardware.network import GRIPPER_COMMAND, IIWA_COMMAND
    from slipmap.diagrams.loops.push_listener import HEARD, PushListener, hearing, record_pushes, why_none
    from slipmap.models.measurements.writing import PushRecorder, is_replaced

    scenario = cell_run.scenario_of(scenario_file, None)
    check_folder(output.resolve().parent, output)
    is_replaced(output.resolve(), overwrite=False)
    listener = PushListener(scenario, output.resolve().name)
    with ExitStack() as stack:
        log = None if log_file is None else stack.enter_context(_new_log(log_file))
        commands = (IIWA_COMMAND, GRIPPER_COMMAND) if log_file is not None else ()
        stream = MessageStream(url, [*HEARD, *commands])
        stack.callback(stream.close)
        note(f"listening at {url}; stop with Ctrl-C")
        with until_ctrl_c() as stopped:
            recorder = PushRecorder(output)
            record_pushes(stream, listener, recorder, status, log=log, most=pushes, stopped=stopped)
    status(hearing(listener))
    lag = None
    if listener.pushes:
        dataset = listener.dataset()
        with suppress(KeyboardInterrupt):  # the pushes are there
            lag = _shown_lag(dataset)
        note(f"pushes: {output}")
    if log_file is not None:
        note(f"messages: {log_file}")
    write_json(json_file, _heard(listener, lag))
    if not listener.pushes:
        raise click.ClickException(f"no push was recorded: {why_none(listener)}")


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@cell_run.scenario_option
@cell_run.folder_option("replay")
@options.hypotheses_option
@options.seed_option
@options.json_in_folder_option
def replay(
    log: Path, scenario_file: Path | None, folder: Path, hypotheses: int, seed: int, json_file: Path | None
) -> None:
    """Find the pushes in a log of messages, and learn from them.

    LOG was written by `slipmap record --log` (LCM or MCAP) or by `lcm-logger`. It is played as fast as
    possible by the senders' time stamps, as if the cell were running. Writes the same files as `slipmap
    explore`, and reports the latency of the camera.
    """
    from slipmap.diagrams.application.commands.identify import show
    from slipmap.diagrams.loops.push_listener import PushListener, why_none
    from slipmap.diagrams.loops.run_folder import refuse_robots_pushes

    scenario = cell_run.scenario_of(scenario_file, None)
    take_folder(folder)
    refuse_robots_pushes(folder)
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
    with all_or_nothing():
        with Progress() as progress:
            written = cell_run.leave(identification, dataset, folder, progress, seed=seed)
        show(identification, dataset, options.typed(folder / "pushes"))
        lag = _shown_lag(dataset)
        write_json(json_file, {**identification.to_json(), "heard": _heard(listener, lag)})
    cell_run.show_files(written)


def _listen(log: Path, listener: PushListener, folder: Path) -> None:
    from slipmap.diagrams.hardware.mcap_log import McapReader
    from slipmap.diagrams.hardware.message_stream import LogReader
    from slipmap.diagrams.loops.push_listener import hearing, record_pushes
    from slipmap.diagrams.loops.run_folder import PUSHES
    from slipmap.models.measurements.writing import PushRecorder

    try:
        with open(log, "rb") as file:
            is_mcap = log.suffix.lower() == MCAP_ENDING
            reader = McapReader(file, str(log)) if is_mcap else LogReader(file, str(log))
            record_pushes(reader, listener, PushRecorder(folder / PUSHES), status)
    except OSError as error:
        raise BadInput(f"{log}: cannot be read ({error.strerror})") from error
    status(hearing(listener))
    if reader.cut_off:
        note(f"warning: {log} ends in the middle of a message; everything before it is used")


def _heard(listener: PushListener, lag: CameraLag | None) -> dict[str, Any]:
    from slipmap.diagrams.loops.push_listener import listened_json

    return {**listened_json(listener), "camera_lag": lag}


def _shown_lag(dataset: PushDataset) -> CameraLag | None:
    """Print and return the camera's latency; None where the pushes do not show it."""
    from slipmap.models.inference.camera_lag import camera_lag

    prepare_kernels()
    with Progress() as progress:
        lag = camera_lag(dataset, progress=progress)
    paragraph(_lag_words(lag))
    return lag


def _lag_words(lag: CameraLag | None) -> str:
    """The camera's latency, in a sentence or two."""
    if lag is None:
        return "Camera: its latency cannot be estimated, because the object was not seen while it moved."
    value, low, high = (1e3 * number for number in (lag.value, lag.low, lag.high))
    numbers = f"{low:.0f} to {high:.0f} ms, from {counted(lag.pushes)}"
    if not lag.shown:
        return f"Camera: no latency relative to the arm is visible ({numbers})."
    which = "late" if value > 0 else "early"
    return (
        f"Camera: its images are {abs(value):.0f} ms {which} relative to the arm ({numbers}). Correct the"
        " clocks of the drivers, or include it in the model: `slipmap fit --effect sensor_latency`."
    )


@contextmanager
def _new_log(path: Path) -> Iterator[LcmLog | McapLog]:
    """A log at a new path, which is free again if the block fails before anything is in the log."""
    check_output(path)
    if path.exists():
        raise BadInput(f"{path}: exists already; choose another name")
    from slipmap.diagrams.hardware.mcap_log import McapLog
    from slipmap.diagrams.hardware.message_stream import LcmLog

    log: LcmLog | McapLog | None = None
    with writing(path), open(path, "xb") as file:
        try:
            if path.suffix.lower() == MCAP_ENDING:
                with closing(McapLog(file)) as log:
                    yield log
            else:
                yield (log := LcmLog(file))
        except BaseException:
            if log is None or not log.count:
                path.unlink(missing_ok=True)
            raise


@click.command()
@cell_run.lcm_option
@cell_run.scenario_option
@cell_run.station_object_option
def station(url: str, scenario_file: Path | None, object_name: str | None) -> None:
    """Simulate a robot's cell with the messages of a real one.

    The simulated arm, gripper and camera send and receive LCM messages in real time like the drivers of an
    iiwa, a Schunk gripper and a depth camera, so `slipmap explore --hardware` in another process sees no
    difference. Runs until Ctrl-C. Every ten seconds, it reports whether it keeps up with real time.
    """
    from slipmap.diagrams.hardware.network import address_settings
    from slipmap.diagrams.hardware.twin import dropped_words, report_words, run_twin

    scenario = cell_run.scenario_of(scenario_file, object_name)
    if scenario_file is None:
        scenario.simulation.time_step = 0.005  # s: the twin must keep up with real time
    try:
        address_settings(url)
        note(f"starting the cell with the {scenario.object.called} at {url} …")
        last = run_twin(scenario, url, lambda report: note(report_words(report)))
    except ValueError as error:
        raise BadInput(str(error)) from error
    note(f"stopped after {last.simulated:.1f} s, {last.behind:.2f} s behind real time{dropped_words(last)}")
