"""`slipmap station`: a twin of the real cell, behind the same messages."""

from pathlib import Path

import click

from slipmap.diagrams.application.commands import cell_run
from slipmap.diagrams.application.terminal import note
from slipmap.models.files import BadInput


@click.command()
@cell_run.lcm_option
@cell_run.scenario_option
@cell_run.station_object_option
def station(url: str, scenario_file: Path | None, object_name: str | None) -> None:
    """Simulate a robot's cell behind the messages of a real one.

    Arm, gripper and camera send and take LCM messages in real time as the drivers of a real iiwa, a Schunk
    gripper and a depth camera do, so that `slipmap explore --hardware` in another process cannot tell the
    difference. It runs until Ctrl-C. Every ten seconds it tells whether it keeps up with real time.
    """
    from slipmap.diagrams.hardware.network import address_settings
    from slipmap.diagrams.hardware.twin import dropped_words, report_words, run_twin

    scenario = cell_run.scenario_of(scenario_file, object_name)
    if scenario_file is None:
        scenario.simulation.time_step = 0.005  # s: the twin must keep up with real time
    try:
        address_settings(url)
        note(f"the cell of the {scenario.object.called} comes up at {url} …")
        last = run_twin(scenario, url, lambda report: note(report_words(report)))
    except ValueError as error:
        raise BadInput(str(error)) from error
    note(f"stopped after {last.simulated:.1f} s, {last.behind:.2f} s behind real time{dropped_words(last)}")
