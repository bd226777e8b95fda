"""Changes of a step by effects and the table's rim: values before it is solved, derivatives after it.

Compilation knows whether there are any: `effects` is None or `Effects`, and `rim` is None or a `Rim`. So what
is absent costs nothing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.blocks import (
    FIXED_ROWS,
    Layout,
    before_masses,
    carry_memory,
    carry_plain_loads,
    padded,
    set_load_slopes,
    set_places,
)
from slipmap.models.physics.compiled import call_address, compiled, without_or_with
from slipmap.models.physics.contact import Cone, cone_of
from slipmap.models.physics.friction import (
    AFTER,
    BODY_OUTPUTS,
    COMPLIANCE,
    CONSTANTS,
    FINGER_SETTLING,
    FORCE,
    INERTIA,
    INERTIA_FACTOR,
    LEAN,
    STATE,
    EffectCells,
    drag_gradients,
    drag_sums,
    load_gradients,
    longest_axis,
    pyramid_slopes,
    stretch_gradients,
    weigh_cells,
)
from slipmap.models.physics.kernel_tools import Formulas, Turn, copy_into
from slipmap.models.physics.newton import LANES, Cells, padded_cells
from slipmap.models.physics.slopes import (
    add_compliance,
    add_formula_slopes,
    blade_slopes,
    set_body_slopes,
)
from slipmap.models.physics.support import (
    CHANGED,
    NEAR,
    TOUCHED,
    add_drag_slopes,
    add_share_slopes,
    clear_lift,
    mass_slopes,
    note_tipping,
    rim_of,
    set_gradients,
    set_share_slopes,
    spread_loads,
    thin_drag,
    wholly_on,
)


class Model(NamedTuple):
    """One hypothesis under one push."""

    load: NDArray[np.float64]  # (n,) friction loads, N, and their sum
    load_sum: float
    cells: Cells  # the same as `Cells`
    body: tuple[float, float, float, float]  # m, s_x, s_y, J
    about_center: float  # moment of inertia about the centre of mass, kg m²
    cone: Cone  # law of the contacts with a rigid finger
    stick_speed: float  # see `Smoothing`
    cell_width: float  # m
    size: float  # see `Common`


class Effects(NamedTuple):
    """Formulas of effects, and storage for their arguments and results, as in `friction.py`."""

    addresses: NDArray[np.int64]  # as in `Formulas`
    memory: int  # E
    # blades, pyramids: their numbers
    blades: int
    pyramids: int
    # cells, stretch: whether cells change; whether Q changes
    cells: bool
    stretch: bool
    bends: bool  # whether the finger bends
    begin: float  # time before the first step, s
    y: NDArray[np.float64]  # (Y,) arguments of the formulas; it holds the memory from step to step
    c: NDArray[np.float64]  # (CONSTANTS,)
    # out, dout: (BODY_OUTPUTS + 4 blades, and 1 + 3 pyramids if any,) and (…, Y), outputs of the body
    out: NDArray[np.float64]
    dout: NDArray[np.float64]
    # blade, pyramid: (blades, 4) and (pyramids, 3) parts of `out`
    blade: NDArray[np.float64]
    pyramid: NDArray[np.float64]
    # factor, drag: (n,) of the cells, or empty
    factor: NDArray[np.float64]
    drag: NDArray[np.float64]
    # qxx, qxy, qyy: (n,) Q of the cells, padded, or empty
    qxx: NDArray[np.float64]
    qxy: NDArray[np.float64]
    qyy: NDArray[np.float64]
    # share, load: (n,) factors, not below 0, and loads times factors, padded
    share: NDArray[np.float64]
    load: NDArray[np.float64]
    by_load: NDArray[np.float64]  # (3, n) see `load_gradients`, padded
    # by_factor, by_drag, by_stretch: (3, n), (3, n), (9, n), filled in by `weigh_cells` and others
    by_factor: NDArray[np.float64]
    by_drag: NDArray[np.float64]
    by_stretch: NDArray[np.float64]
    after: NDArray[np.float64]  # (AFTER,)
    # own, down: (E - FORCE,) and (…, Y + AFTER) of the memory besides the force
    own: NDArray[np.float64]
    down: NDArray[np.float64]
    G: NDArray[np.float64]  # (3, Y) derivative of the gradient with respect to y


class Motion(NamedTuple):
    """Pose in the world with the angle's cosine and sine, twist (object frame), and `Turn` by h omega/4."""

    x: float
    y: float
    theta: float
    cos: float
    sin: float
    v: tuple[float, float, float]
    quarter: Turn


class Terms(NamedTuple):
    """The parts of a step that effects change."""

    cells: Any  # `Cells`, or `EffectCells`
    cone: Cone  # law of the contacts
    kappa: float  # factor on the inertia
    # impulse of forces, middle frame: two components, N s, and moment about the origin, N m s
    added: tuple[float, float, float]
    bend: tuple[float, float]  # offset of the finger from its recorded place, world, m


@compiled()
def model_of(common, maps, k, h):  # type: ignore[no-untyped-def]
    """`Model` k for steps of length h."""
    load, inertia, smoothing = maps.load[k], maps.inertia[k], common.smoothing
    load_sum = load.sum()
    m, sx, sy, J = inertia[0], inertia[1], inertia[2], inertia[3]
    cells = padded_cells(load, common.rx, common.ry, common.cell_width, smoothing[0])
    cone = cone_of(maps.mu[k], smoothing, load_sum, 0.0, h)
    about_center = J - (sx * sx + sy * sy) / m
    return Model(
        load, load_sum, cells, (m, sx, sy, J), about_center, cone, smoothing[1], common.cell_width,
        common.size,
    )  # fmt: skip


@compiled(forceinline=True)
def _no_effects(formulas, k, b, model, columns, memory):  # type: ignore[no-untyped-def]
    n = model.load.shape[0]
    return None, Layout(n, max(columns - n, 0), 0, 0, 0), 0.0


@compiled(forceinline=True)
def _split(numbers, count):  # type: ignore[no-untyped-def]
    """The first `count` numbers, and the others."""
    return numbers[:count], numbers[count:]


@compiled()
def _some_effects(formulas, k, b, model, columns, memory):  # type: ignore[no-untyped-def]
    given = Formulas(*formulas)
    sizes = given.sizes
    E, P, blades, cells, stretch = sizes[0], sizes[1], sizes[2], sizes[3] != 0, sizes[4] != 0
    pyramids, bends = sizes[5], sizes[6] != 0
    known, own = STATE + E, max(0, E - FORCE)
    after_blades = BODY_OUTPUTS + 4 * blades
    Y, outputs = known + INERTIA + P, after_blades + (1 + 3 * pyramids if pyramids > 0 else 0)
    n, filled = model.load.shape[0], model.cells.rx.shape[0]
    changed, stretched = n if cells else 0, filled if stretch else 0
    # One allocation for many arrays, since each one takes time.
    room = np.zeros(Y + CONSTANTS + outputs + 2 * changed + 3 * stretched + 2 * filled + AFTER + own)
    y, room = _split(room, Y)
    c, room = _split(room, CONSTANTS)
    out, room = _split(room, outputs)
    factor, room = _split(room, changed)
    drag, room = _split(room, changed)
    qxx, room = _split(room, stretched)
    qxy, room = _split(room, stretched)
    qyy, room = _split(room, stretched)
    share, room = _split(room, filled)
    load, room = _split(room, filled)
    after, room = _split(room, AFTER)
    share[:] = 1.0
    qxx[:] = 1.0
    qyy[:] = 1.0
    copy_into(load, model.cells.load)
    copy_into(c, given.constants[b])
    y[known], y[known + 1], y[known + 2], y[known + 3] = model.body
    for e in range(min(E, memory.shape[0])):
        y[STATE + e] = memory[e]
    copy_into(y[known + INERTIA :], given.parameters[k])
    none = np.zeros((0, 0))
    delay = given.delay[k] if given.delay.shape[0] > 0 else 0.0
    derive = columns > 0
    changes = derive and cells
    effects = Effects(
        given.addresses, E, blades, pyramids, cells, stretch, bends, c[0], y, c, out, np.zeros((outputs, Y)),
        out[BODY_OUTPUTS:after_blades].reshape(blades, 4),
        out[outputs - 3 * pyramids :].reshape(pyramids, 3), factor, drag, qxx, qxy, qyy, share, load,
        np.zeros((3, filled)) if derive else none,
        np.zeros((3, n)) if changes else none,
        np.zeros((3, n)) if changes else none,
        np.zeros((9, n)) if derive and stretch else none,
        after, room, np.zeros((own, Y + AFTER)), np.zeros((3, Y)) if derive else none,
    )  # fmt: skip
    return effects, Layout(n, max(columns - n, 0), E, P, 0), delay


effects_of = without_or_with(_no_effects, _some_effects)
"""`Effects` of model k under push b, or None; `Layout` of the Jacobian; the tracker's delay, s.

Args:
    formulas: fields of `Formulas`, or None.
    k, b: numbers of the model and of the push.
    model: `Model`.
    columns: of the Jacobian, 0 for none.
    memory: (E,) before the first step, or empty for none.
"""


@compiled(forceinline=True)
def _no_table(table, k, b):  # type: ignore[no-untyped-def]
    return None


@compiled(forceinline=True)
def _own_table(table, k, b):  # type: ignore[no-untyped-def]
    return table[min(k, table.shape[0] - 1), min(b, table.shape[1] - 1)]


table_of = without_or_with(_no_table, _own_table)
"""The table (7,) of model k under push b, of tables (K, B, 7) or one for all (1, 1, 7); or None."""


@compiled(forceinline=True)
def _no_rim(table, mass, model, layout):  # type: ignore[no-untyped-def]
    return None, layout


@compiled(forceinline=True)
def _some_rim(table, mass, model, layout):  # type: ignore[no-untyped-def]
    n, others, memory, effects, _ = layout
    derive = others > 0
    rim = rim_of(table, mass, model.body, model.cells, model.cell_width, model.size, derive)
    return rim, Layout(n, others, memory, effects, n if derive else 0)


rim_under = without_or_with(_no_rim, _some_rim)
"""`Rim` of a table (7,), or None, under a `Model` with cell masses (n,); `Layout` with space for them."""


@compiled(forceinline=True)
def _on_floor(rim, model, motion, time):  # type: ignore[no-untyped-def]
    return model


@compiled(forceinline=True)
def _on_table(rim, model, motion, time):  # type: ignore[no-untyped-def]
    flags, cells, load = rim.flags, model.cells, model.load
    x, y, cos, sin = motion.x, motion.y, motion.cos, motion.sin
    if wholly_on(rim, x, y):
        flags[NEAR] = 0
        return model
    flags[NEAR] = flags[TOUCHED] = 1
    spread_loads(rim, model.body, x, y, cos, sin)
    note_tipping(rim, x, y, cos, sin, model.cell_width, time)
    carried = Cells(rim.load, cells.rx, cells.ry, cells.rho2, cells.eps2)
    return Model(
        rim.load[: load.shape[0]], model.load_sum, carried, model.body, model.about_center, model.cone,
        model.stick_speed, model.cell_width, model.size,
    )  # fmt: skip


supported = without_or_with(_on_floor, _on_table)
"""The `Model` with its friction loads at a `Motion`, at a time from the push's start, s."""


@compiled(forceinline=True)
def _plain_terms(effects, rim, model, motion, number, h):  # type: ignore[no-untyped-def]
    return Terms(model.cells, model.cone, 1.0, (0.0, 0.0, 0.0), (0.0, 0.0))


@compiled(forceinline=True)
def _renew_loads(rim, load, carried):  # type: ignore[no-untyped-def]
    """Copy the loads that a table carries: they change from step to step even without an effect on them."""
    if rim is not None:
        copy_into(load, carried)


@compiled(forceinline=True)
def _changed_terms(effects, rim, model, motion, number, h):  # type: ignore[no-untyped-def]
    y, c, out, plain = effects.y, effects.c, effects.out, model.cells
    c[0] = effects.begin + (number + 0.5) * h
    y[0], y[1], y[2] = motion.x, motion.y, motion.theta
    y[3], y[4], y[5] = motion.v
    call_address(effects.addresses[0], (y, c, out, effects.dout))
    qxx, qxy, qyy = effects.qxx, effects.qxy, effects.qyy
    longest = 1.0
    drag = (0.0, 0.0, 0.0, 0.0)
    if effects.cells:
        arrays = (y, c, plain.rx, plain.ry, effects.factor, effects.drag, qxx, qxy, qyy)
        call_address(effects.addresses[1], arrays)
        for i in range(model.load.shape[0]):
            effects.share[i] = max(effects.factor[i], 0.0)
            effects.load[i] = model.load[i] * effects.share[i]
        thin_drag(rim, effects.drag)
        drag = drag_sums(effects.drag, plain.rx, plain.ry, model.cell_width)
        if effects.stretch:
            longest = longest_axis(qxx, qxy, qyy)
    else:
        _renew_loads(rim, effects.load, plain.load)
    cells = EffectCells(
        effects.load, plain.rx, plain.ry, plain.rho2, plain.eps2, effects.stretch, qxx, qxy, qyy, longest,
        drag, effects.blade, out[BODY_OUTPUTS + 4 * effects.blades] if effects.pyramids > 0 else 1.0,
        effects.pyramid,
    )  # fmt: skip
    cone, bend = model.cone, (0.0, 0.0)
    if effects.bends:
        mu, give, _, _, damping, ramp = model.cone
        compliance = out[COMPLIANCE]
        within = compliance * h / max(h, FINGER_SETTLING)
        tangential = h * h / (h * model.stick_speed / model.load_sum + within)
        cone = Cone(mu, give, within, tangential, damping, ramp)
        bend = (compliance * y[LEAN], compliance * y[LEAN + 1])
    return Terms(cells, cone, out[INERTIA_FACTOR], (h * out[0], h * out[1], h * out[2]), bend)


terms_at = without_or_with(_plain_terms, _changed_terms)
"""`Terms` of step `number`, of length h, from a `Motion`; `model` has the loads that the table carries."""


@compiled(forceinline=True)
def is_pulled(effects):  # type: ignore[no-untyped-def]
    """Whether effects would pull at a resting object if their parameters were slightly different."""
    return effects is not None and effects.dout[:INERTIA_FACTOR].any()


@compiled(forceinline=True)
def add_rim_slopes(rim, effects, motion, terms, taken, slopes):  # type: ignore[no-untyped-def]
    """Add the contribution of shifting loads to the `Slopes` of a `Taken` step."""
    if rim is None:
        return
    if rim.flags[NEAR] != 0:
        set_share_slopes(rim, motion.x, motion.y, motion.cos, motion.sin)
        set_gradients(rim, effects, terms.cells, taken.new)
        add_share_slopes(rim, _factors(effects, rim.ones), taken.h, slopes.state)


@compiled(forceinline=True)
def _ones(effects, ones):  # type: ignore[no-untyped-def]
    return ones


@compiled(forceinline=True)
def _shares(effects, ones):  # type: ignore[no-untyped-def]
    return effects.share


_factors = without_or_with(_ones, _shares)


@compiled(forceinline=True)
def add_effect_slopes(effects, rim, model, terms, taken, slopes):  # type: ignore[no-untyped-def]
    """Add the contribution of the effects' formulas to the `Slopes` of a `Taken` step."""
    if effects is None:
        return
    new, h, G, dout = taken.new, taken.h, effects.G, effects.dout
    cells, rx, ry = terms.cells, model.cells.rx, model.cells.ry
    set_body_slopes(G, model.body, new, taken.free, dout, h)
    if effects.blades > 0:
        blade_slopes(effects.blade, dout[BODY_OUTPUTS:], new, cells.eps2, h, G)
    if effects.pyramids > 0:
        pyramid_slopes(cells, dout[BODY_OUTPUTS + 4 * effects.blades :], new, h, G)
    if effects.cells:
        load_gradients(cells, new, effects.by_load)
        drag_gradients(cells, new, h, model.cell_width, effects.by_drag)
        add_drag_slopes(rim, effects.drag, effects.by_drag, slopes.state)
        stretch_gradients(cells, new, h, effects.by_stretch)
        weigh_cells(model.load, effects.factor, h, effects.by_load, effects.by_factor)
        arrays = (effects.y, effects.c, rx, ry, effects.by_factor, effects.by_drag, effects.by_stretch, G)
        call_address(effects.addresses[2], arrays)
    if effects.bends:
        lean = (effects.y[LEAN], effects.y[LEAN + 1])
        compliance = effects.out[COMPLIANCE]
        add_compliance(taken, compliance, lean, model.stick_speed, model.load_sum, slopes.state)
    add_formula_slopes(slopes, G, dout, terms.kappa)


@compiled(forceinline=True)
def carry_loads(effects, rim, S, layout, model, terms, taken, slopes, pose):  # type: ignore[no-untyped-def]
    """Carry the loads' state rows over a `Taken` step, in place, or only set their direct rows.

    Returns:
        The first block that is not yet carried.
    """
    new, minimum, h = taken.new, taken.minimum, taken.h
    if rim is not None and rim.flags[NEAR] != 0:
        rim.flags[CHANGED] = 1
        set_load_slopes(S, layout, rim.by_load, rim.total, h, slopes.state)
        return 0
    if effects is None or (effects.memory == 0 and effects.pyramids == 0 and not effects.cells):
        _put_back_places(rim, S, layout)
        carry_plain_loads(S, model.cells, new, h, slopes.state, minimum, pose)
        return padded(layout.n) // LANES
    if not effects.cells:
        load_gradients(terms.cells, new, effects.by_load)
    set_load_slopes(S, layout, effects.by_load, effects.share, h, slopes.state)
    return 0


@compiled(forceinline=True)
def _put_back_places(rim, S, layout):  # type: ignore[no-untyped-def]
    if rim is None:
        return
    if rim.flags[CHANGED] != 0:
        rim.flags[CHANGED] = 0
        set_places(S, layout, rim.rx, rim.ry)


@compiled(forceinline=True)
def _all_blocks(rim, S, layout):  # type: ignore[no-untyped-def]
    return S


@compiled(forceinline=True)
def _blocks_at_work(rim, S, layout):  # type: ignore[no-untyped-def]
    return S if rim.flags[TOUCHED] != 0 else S[: before_masses(S, layout)]


at_work = without_or_with(_all_blocks, _blocks_at_work)
"""Blocks S, with as many rows as a state's, without those of the masses while these are zero."""


@compiled(forceinline=True)
def set_mass_slopes(rim, S, layout):  # type: ignore[no-untyped-def]
    """Set the direct rows of the masses, if the blocks hold any."""
    if rim is None:
        return
    if rim.flags[TOUCHED] != 0:
        if rim.flags[NEAR] == 0:
            clear_lift(rim.lift)
        first, size = before_masses(S, layout), (FIXED_ROWS + layout.memory) * LANES
        for b in range(padded(layout.masses) // LANES):
            at, cells = first + b * size + STATE * LANES, slice(b * LANES, (b + 1) * LANES)
            block = S[at : at + 3 * LANES]
            mass_slopes(rim.rx[cells], rim.ry[cells], rim.factor[cells], rim.lift, block)


@compiled(forceinline=True)
def remember(effects, S, before, F, layout, after, force):  # type: ignore[no-untyped-def]
    """Update the memory and its rows after a step, from the `Motion` after it and the force (world, N)."""
    if effects is None or effects.memory == 0:
        return
    y, own = effects.y, effects.own
    if effects.memory > FORCE:
        numbers = effects.after
        numbers[0], numbers[1], numbers[2] = after.x, after.y, after.theta
        numbers[3], numbers[4], numbers[5] = after.v
        numbers[6], numbers[7] = force
        call_address(effects.addresses[3], (y, effects.c, numbers, own, effects.down))
    if layout.others > 0:
        carry_memory(S, before, F, layout, effects.down)
    y[STATE], y[STATE + 1] = force
    for e in range(own.shape[0]):
        y[STATE + FORCE + e] = own[e]
