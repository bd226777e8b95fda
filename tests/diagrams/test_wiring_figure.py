"""The chart of a diagram's wiring shows every system and every connection where it belongs."""

from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain, Integrator

from diagrams.figures.wiring import wiring_figure


def test_every_connection_stands_in_its_source_s_row_and_its_target_s_column():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([1.0]))
    adder = builder.AddNamedSystem("adder", Adder(2, 1))
    state = builder.AddNamedSystem("the_state", Integrator(1))
    gain = builder.AddNamedSystem("gain", Gain(-1.0, 1))
    builder.Connect(source.get_output_port(), adder.get_input_port(0))
    builder.Connect(adder.get_output_port(), state.get_input_port())
    builder.Connect(state.get_output_port(), gain.get_input_port())
    builder.Connect(gain.get_output_port(), adder.get_input_port(1))
    (axes,) = wiring_figure(builder.Build()).axes
    shown = {text.get_position(): text.get_text() for text in axes.texts}
    assert shown == {
        (0.5, 0.5): "source",
        (1.5, 1.5): "adder",
        (2.5, 2.5): "the\nstate",
        (3.5, 3.5): "gain",
        (1.5, 0.5): source.get_output_port().get_name(),
        (2.5, 1.5): adder.get_output_port().get_name(),
        (3.5, 2.5): state.get_output_port().get_name(),
        (1.5, 3.5): gain.get_output_port().get_name(),
    }


def test_ports_between_the_same_systems_share_a_place_and_one_port_is_named_once():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([1.0]))
    adder = builder.AddNamedSystem("adder", Adder(2, 1))
    for k in range(2):
        builder.Connect(source.get_output_port(), adder.get_input_port(k))
    (axes,) = wiring_figure(builder.Build()).axes
    assert [t.get_text() for t in axes.texts if t.get_position() == (1.5, 0.5)] == [
        source.get_output_port().get_name()
    ]
