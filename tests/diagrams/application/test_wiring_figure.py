"""The chart of a diagram's wiring shows every system and every connection where it belongs."""

from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain, Integrator

from notebooks.wiring import broken, wiring_figure


def texts_of(figure, names):
    """Texts by row and column, lines joined, where the systems of these names stand on the diagonal; and
    the places of those."""
    (axes,) = figure.axes
    places = [next(t.get_position() for t in axes.texts if t.get_text() == name) for name in names]
    columns, rows = ([round(place[axis], 6) for place in places] for axis in (0, 1))
    shown = {}
    for text in axes.texts:
        x, y = (round(value, 6) for value in text.get_position())
        joint = " " if text.get_text() in names else ""
        assert (rows.index(y), columns.index(x)) not in shown
        shown[rows.index(y), columns.index(x)] = text.get_text().replace("\n", joint)
    return shown, places


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
    shown, places = texts_of(wiring_figure(builder.Build()), ("source", "adder", "the\nstate", "gain"))
    systems = {(k, k): name for k, name in enumerate(("source", "adder", "the state", "gain"))}
    assert shown == systems | {
        (0, 1): source.get_output_port().get_name(),
        (1, 2): adder.get_output_port().get_name(),
        (2, 3): state.get_output_port().get_name(),
        (3, 1): gain.get_output_port().get_name(),
    }
    assert places == sorted(places)


def test_ports_between_the_same_systems_share_a_place_and_one_port_is_named_once():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([1.0]))
    adder = builder.AddNamedSystem("adder", Adder(2, 1))
    for k in range(2):
        builder.Connect(source.get_output_port(), adder.get_input_port(k))
    shown, _ = texts_of(wiring_figure(builder.Build()), ("source", "adder"))
    assert shown[0, 1] == source.get_output_port().get_name()


def test_long_names_of_ports_are_broken_at_dots_and_underscores():
    assert broken("iiwa.position_measured") == "iiwa.position_\n  measured"
    assert broken("camera.age") == "camera.age"
    assert broken("withoutanyplacetobreak") == "withoutanyplacetobreak"
