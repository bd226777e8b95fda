"""One step of the model, and rollouts of many: the compiled loop, with the Jacobian carried along.

A step goes, in the order of this file,

    terms_at     what effects change in this step, by their formulas at the state before it
    take_step    free motion and given forces, the finger, contacts, the minimum, the way along it
    set_slopes   direct derivatives of its gradient and of the finger's impulse
    carry        the Jacobian over the step

`_roll` repeats it; `rollout_all` and `single_steps` are the doors, from `rollout.py` and `stepper.py`. A
single step is a rollout of one step that is differentiated by what drives it, too.

`effects` is None where the model is the plain one, and `single` None in rollouts: the branches that follow
from that are chosen when it is compiled, so that what is absent costs nothing.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from slipmap.models.physics.blocks import (
    FIXED_ROWS,
    Layout,
    carry_direct,
    carry_memory,
    carry_plain_loads,
    empty_blocks,
    fill_force,
    first_blocks,
    padded,
    pose_update,
    set_load_slopes,
    set_other_slopes,
    store_rows,
)
from slipmap.models.physics.compiled import (
    address_of,
    borrowed,
    call_address,
    call_compiled,
    compiled,
    keep,
    without_or_with,
)
from slipmap.models.physics.contact import CONTACT_COLUMNS, MAX_CONTACTS, Cone, cone_of
from slipmap.models.physics.friction import (
    AFTER,
    BODY_OUTPUTS,
    COMPLIANCE,
    CONSTANTS,
    FORCE,
    INERTIA,
    INERTIA_FACTOR,
    STATE,
    EffectCells,
    drag_gradients,
    drag_sums,
    load_gradients,
    longest_axis,
    stretch_gradients,
    weigh_cells,
)
from slipmap.models.physics.kernel_arguments import Common, Formulas, JoinedPushes, ReducedMaps, Results
from slipmap.models.physics.kernel_tools import (
    OnePush,
    Turn,
    copy_into,
    evenly_dealt,
    joined,
    push_of,
    results_of,
    step_of,
    turn_by,
    turned,
)
from slipmap.models.physics.newton import LANES, Cells, Minimum, padded_cells
from slipmap.models.physics.slopes import (
    Slopes,
    Solved,
    add_applied_turning,
    add_bending,
    add_formula_slopes,
    blade_slopes,
    by_load_sum,
    by_stiffness,
    finger_impulse,
    no_slopes,
    set_body_slopes,
    set_input_slopes,
    step_derivative,
)
from slipmap.models.physics.step import (
    MAX_EVALUATIONS,
    Applied,
    Frame,
    Step,
    Way,
    applied_impulse,
    bent_frame,
    best_weights,
    contact_of,
    free_momentum,
    middle_frame,
    solve_step,
    touching,
    way_of,
    weighted,
)

_FIRST, _WHOLE = np.zeros(1, np.int64), np.ones(1)
# Where a single step's pose and force are wanted: in the first step, at its end.

INPUTS = 9
"""Last columns of a single step's Jacobian: wrench (5), finger before and after (4), which drive it."""


class Model(NamedTuple):
    """One hypothesis under one push.

    Attributes:
        load: (n,) friction loads, N, and their sum.
        cells: the same as `Cells`.
        body: m, s_x, s_y, J.
        about_center: moment of inertia about the centre of mass, kg m².
        cone: law of the contacts with a rigid finger.
        stick_speed: see `Smoothing`.
        cell_width: m.
        size: see `Common`.
    """

    load: NDArray[np.float64]
    load_sum: float
    cells: Cells
    body: tuple[float, float, float, float]
    about_center: float
    cone: Cone
    stick_speed: float
    cell_width: float
    size: float


class Effects(NamedTuple):
    """Formulas of effects, and room for what they are evaluated at and give, as in `friction.py`.

    Attributes:
        addresses: as in `Formulas`.
        memory, parameters: E, P.
        blades: how many there are.
        cells, stretch: whether cells are changed; whether Q is.
        delay: of the tracker, s.
        begin: time before the first step, s.
        y: (Y,) what formulas are evaluated at, of which the memory is kept there from step to step.
        c: (CONSTANTS,).
        out, dout: (BODY_OUTPUTS + 4 blades,) and (…, Y) of the body.
        blade: (blades, 4) part of `out`.
        factor, drag: (n,) of the cells, or without entries.
        qxx, qxy, qyy: (n,) Q of the cells, filled up, or without entries.
        share, load: (n,) factors, not below 0, and loads times them, filled up.
        by_load: (3, n) see `load_gradients`, filled up.
        by_factor, by_drag, by_stretch: (3, n), (3, n), (9, n) what `weigh_cells` and others fill in.
        after: (AFTER,).
        own, down: (E - FORCE,) and (…, Y + AFTER) of the effects' own memory.
        G: (3, Y) derivative of the gradient by y.
    """

    addresses: NDArray[np.int64]
    memory: int
    parameters: int
    blades: int
    cells: bool
    stretch: bool
    delay: float
    begin: float
    y: NDArray[np.float64]
    c: NDArray[np.float64]
    out: NDArray[np.float64]
    dout: NDArray[np.float64]
    blade: NDArray[np.float64]
    factor: NDArray[np.float64]
    drag: NDArray[np.float64]
    qxx: NDArray[np.float64]
    qxy: NDArray[np.float64]
    qyy: NDArray[np.float64]
    share: NDArray[np.float64]
    load: NDArray[np.float64]
    by_load: NDArray[np.float64]
    by_factor: NDArray[np.float64]
    by_drag: NDArray[np.float64]
    by_stretch: NDArray[np.float64]
    after: NDArray[np.float64]
    own: NDArray[np.float64]
    down: NDArray[np.float64]
    G: NDArray[np.float64]


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
    """What of a step effects change.

    Attributes:
        cells: `Cells`, or `EffectCells`.
        kappa: factor on the inertia.
        compliance: of the finger, m/N.
        added: impulse of given forces, middle frame: two components, N s, and moment about the origin, N m s.
        bend: how far the finger stands off its record, world, m.
    """

    cells: Any
    kappa: float
    compliance: float
    added: tuple[float, float, float]
    bend: tuple[float, float]


class Taken(NamedTuple):
    """A step that was taken.

    Attributes:
        new: twist after it.
        minimum: see `Solution`.
        solved: see `Solved`.
        free: momentum of the free motion.
        applied: given forces of the push.
        impulse: of the finger on the object, middle frame, N s.
        way: see `Way`.
        evaluations: see `Solution`.
    """

    new: tuple[float, float, float]
    minimum: Minimum
    solved: Solved
    free: tuple[float, float, float]
    applied: Applied
    impulse: tuple[float, float]
    way: Way
    evaluations: int


class Room(NamedTuple):
    """Where a rollout keeps its derivatives and contacts.

    Attributes:
        S, before, F: blocks after a step, before it, and of the finger's force, see `blocks.py`.
        slopes: see `Slopes`.
        contacts: (MAX_CONTACTS, CONTACT_COLUMNS).
    """

    S: NDArray[np.float64]
    before: NDArray[np.float64]
    F: NDArray[np.float64]
    slopes: Slopes
    contacts: NDArray[np.float64]


class Single(NamedTuple):
    """What a step that stands alone has besides.

    Attributes:
        state: (Z,) state before it, the finger's last force (world, N), the effects' own memory.
        jacobian: (Z, columns) derivative of the same after it, or without columns.
    """

    state: NDArray[np.float64]
    jacobian: NDArray[np.float64]


@compiled()
def _model_of(common, maps, k, h):  # type: ignore[no-untyped-def]
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


@compiled()
def _no_effects(formulas, k, b, inertia, model, derive):  # type: ignore[no-untyped-def]
    return None


@compiled(forceinline=True)
def _split(numbers, count):  # type: ignore[no-untyped-def]
    """The first numbers, so many of them, and the others."""
    return numbers[:count], numbers[count:]


@compiled()
def _some_effects(formulas, k, b, inertia, model, derive):  # type: ignore[no-untyped-def]
    """`Effects` of model k under push b from the fields of `Formulas`."""
    given = Formulas(*formulas)
    sizes = given.sizes
    E, P, blades, cells, stretch = sizes[0], sizes[1], sizes[2], sizes[3] != 0, sizes[4] != 0
    known, own = STATE + E, max(0, E - FORCE)
    Y, outputs = known + INERTIA + P, BODY_OUTPUTS + 4 * blades
    n, filled = model.load.shape[0], model.cells.rx.shape[0]
    changed, stretched = n if cells else 0, filled if stretch else 0
    # One piece of memory for many, as each one takes time to get.
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
    copy_into(y[known : known + INERTIA], inertia)
    copy_into(y[known + INERTIA :], given.parameters[k])
    none = np.zeros((0, 0))
    delay = given.delay[k] if given.delay.shape[0] > 0 else 0.0
    changes = derive and cells
    return Effects(
        given.addresses, E, P, blades, cells, stretch, delay, c[0], y, c, out, np.zeros((outputs, Y)),
        out[BODY_OUTPUTS:].reshape(blades, 4), factor, drag, qxx, qxy, qyy, share, load,
        np.zeros((3, filled)) if derive else none,
        np.zeros((3, n)) if changes else none,
        np.zeros((3, n)) if changes else none,
        np.zeros((9, n)) if derive and stretch else none,
        after, room, np.zeros((own, Y + AFTER)), np.zeros((3, Y)) if derive else none,
    )  # fmt: skip


effects_of = without_or_with(_no_effects, _some_effects)


@compiled(forceinline=True)
def _plain_terms(effects, model, motion, number, h):  # type: ignore[no-untyped-def]
    return Terms(model.cells, 1.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0))


@compiled(forceinline=True)
def _changed_terms(effects, model, motion, number, h):  # type: ignore[no-untyped-def]
    """`Terms` of the step with this number, from this motion."""
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
        drag = drag_sums(effects.drag, plain.rx, plain.ry, model.cell_width)
        if effects.stretch:
            longest = longest_axis(qxx, qxy, qyy)
    cells = EffectCells(
        effects.load, plain.rx, plain.ry, plain.rho2, plain.eps2, effects.stretch, qxx, qxy, qyy, longest,
        drag, effects.blade,
    )  # fmt: skip
    compliance = out[COMPLIANCE]
    bend = (0.0, 0.0)
    if effects.memory > 0:
        bend = (compliance * y[STATE], compliance * y[STATE + 1])
    return Terms(cells, out[INERTIA_FACTOR], compliance, (h * out[0], h * out[1], h * out[2]), bend)


terms_at = without_or_with(_plain_terms, _changed_terms)


@compiled(forceinline=True)
def _cone_at(effects, model, compliance, h):  # type: ignore[no-untyped-def]
    """Law of the contacts with a finger of this compliance, m/N."""
    if effects is None:
        return model.cone
    mu, give, _, _, damping, ramp = model.cone
    tangential = h * h / (h * model.stick_speed / model.load_sum + compliance)
    return Cone(mu, give, compliance, tangential, damping, ramp)


@compiled(forceinline=True)
def _bent(effects, frame, bend, h):  # type: ignore[no-untyped-def]
    return frame if effects is None else bent_frame(frame, bend[0], bend[1], h)


@compiled(inline="always")
def take_step(effects, model, common, push, number, terms, motion, guess, rows, derive):  # type: ignore[no-untyped-def]
    """`Taken`, the step with this number from this motion; `guess` is one of the new twist."""
    h, v, cos, sin, quarter = push.h, motion.v, motion.cos, motion.sin, motion.quarter
    half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
    full_cos, full_sin = joined(half_cos, half_sin, half_cos, half_sin)
    free = free_momentum(model.body, v, full_cos, full_sin)
    middle_cos, middle_sin = joined(cos, sin, half_cos, half_sin)
    applied = Applied(0.0, 0.0, 0.0, 0.0)
    added_x, added_y, added_w = terms.added
    if push.wrench.shape[0] > 0:
        applied = applied_impulse(push.wrench[number], middle_cos, middle_sin, h)
        added_x += applied.x
        added_y += applied.y
        added_w += applied.spin
    kappa, body = terms.kappa, model.body
    star = (kappa * free[0] + added_x, kappa * free[1] + added_y, kappa * free[2] + added_w)
    inertia = (kappa * body[0], kappa * body[1], kappa * body[2], kappa * body[3])

    bend_x, bend_y = terms.bend
    tip0 = (push.tip[number, 0] - bend_x, push.tip[number, 1] - bend_y)
    tip1 = (push.tip[number + 1, 0] - bend_x, push.tip[number + 1, 1] - bend_y)
    frame = Frame(middle_cos, middle_sin, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    count = 0
    if not math.isnan(tip0[0]) and not math.isnan(tip1[0]):
        frame = middle_frame(motion.x, motion.y, cos, sin, quarter, v, h, tip0, tip1)
        frame = _bent(effects, frame, terms.bend, h)
        gain = abs(frame.spring_x) + abs(frame.spring_y)
        if added_x != 0.0 or added_y != 0.0 or added_w != 0.0:
            gain += math.hypot(added_x, added_y) / body[0] + model.size * abs(added_w) / model.about_center
        count = touching(frame, v, h, common, rows, gain)
    cone = _cone_at(effects, model, terms.compliance, h)
    first = contact_of(rows, 0, frame, v, h, cone)
    second = contact_of(rows, 1, frame, v, h, cone)

    step = Step(terms.cells, inertia, star, h, first, second, count, cone, model.size, v, quarter, frame)
    new, minimum, evaluations = solve_step(step, guess, derive)
    solved = Solved(
        v, new, h, inertia, cone, frame, quarter, first, second, minimum.first, minimum.second
    )  # fmt: skip
    way = way_of(new, cos, sin, h)
    return Taken(new, minimum, solved, free, applied, finger_impulse(solved), way, evaluations)


@compiled(forceinline=True)
def _moved(motion, taken, h):  # type: ignore[no-untyped-def]
    """`Motion` after a step."""
    way = taken.way
    cos, sin = joined(way.cos, way.sin, way.half_cos, way.half_sin)
    x, y = motion.x + way.length * way.wx, motion.y + way.length * way.wy
    return Motion(x, y, motion.theta + h * taken.new[2], cos, sin, taken.new, way.quarter)


@compiled(forceinline=True)
def _remember(effects, motion, force):  # type: ignore[no-untyped-def]
    """Evaluate the effects' own memory after a step with this motion after it and this force, world, N."""
    if effects is not None and effects.memory > FORCE:
        after = effects.after
        after[0], after[1], after[2] = motion.x, motion.y, motion.theta
        after[3], after[4], after[5] = motion.v
        after[6], after[7] = force
        call_address(effects.addresses[3], (effects.y, effects.c, after, effects.own, effects.down))


@compiled(forceinline=True)
def _keep(effects, force):  # type: ignore[no-untyped-def]
    """Put what is remembered where the next step looks for it."""
    if effects is not None and effects.memory > 0:
        effects.y[STATE], effects.y[STATE + 1] = force
        for e in range(effects.own.shape[0]):
            effects.y[STATE + FORCE + e] = effects.own[e]


@compiled(forceinline=True)
def set_slopes(effects, single, model, push, number, terms, taken, slopes):  # type: ignore[no-untyped-def]
    """Set the `Slopes` of a step; returns the derivatives of its gradient (3) and impulse (2) by Σ f."""
    step_derivative(taken.solved, slopes)
    add_applied_turning(slopes.state_g, taken.applied, push.h)
    by_sum = by_load_sum(taken.solved, model.load_sum)
    if effects is not None:
        by_sum = _add_effect_slopes(effects, model, terms, taken, slopes, by_sum)
    if single is not None:
        at = single.jacobian.shape[1] - model.load.shape[0] - INPUTS
        set_input_slopes(taken.solved, taken.applied, push.wrench[number], at, slopes)
    return by_sum


@compiled(forceinline=True)
def _add_effect_slopes(effects, model, terms, taken, slopes, by_sum):  # type: ignore[no-untyped-def]
    """Add what effects do to the slopes of a step, and to those by Σ f."""
    solved, new, G, dout = taken.solved, taken.new, effects.G, effects.dout
    h, cells, rx, ry = solved.h, terms.cells, model.cells.rx, model.cells.ry
    set_body_slopes(G, model.body, new, taken.free, dout, h)
    if effects.blades > 0:
        blade_slopes(effects.blade, dout[BODY_OUTPUTS:], new, cells.eps2, h, G)
    if effects.cells:
        load_gradients(cells, new, effects.by_load)
        drag_gradients(cells, new, h, model.cell_width, effects.by_drag)
        stretch_gradients(cells, new, h, effects.by_stretch)
        weigh_cells(model.load, effects.factor, h, effects.by_load, effects.by_factor)
        arrays = (effects.y, effects.c, rx, ry, effects.by_factor, effects.by_drag, effects.by_stretch, G)
        call_address(effects.addresses[2], arrays)
    if effects.memory > 0:
        last = (effects.y[STATE], effects.y[STATE + 1])
        by_compliance = by_stiffness(solved, False, model.stick_speed, model.load_sum)
        add_bending(solved, last, by_compliance, slopes)
        by_sum = by_stiffness(solved, True, model.stick_speed, model.load_sum)
    add_formula_slopes(slopes, G, dout, terms.kappa)
    return by_sum


@compiled(forceinline=True)
def carry(effects, S, layout, model, terms, taken, slopes, by_sum):  # type: ignore[no-untyped-def]
    """Carry the state's rows of the Jacobian over a step, in place."""
    h, minimum, pose = taken.solved.h, taken.minimum, pose_update(taken.way, taken.solved.h)
    first = padded(layout.n) // LANES
    if _has_plain_loads(effects):
        carry_plain_loads(S, model.cells, taken.new, h, slopes, by_sum, minimum, pose)
    else:
        _set_load_slopes(effects, S, layout, terms, taken, by_sum)
        first = 0
    set_other_slopes(S, layout, slopes.other_g)
    carry_direct(S, first, layout, slopes, minimum, pose, h)


@compiled(forceinline=True)
def _has_plain_loads(effects):  # type: ignore[no-untyped-def]
    """Whether the blocks of loads are those of the plain model."""
    if effects is None:
        return True
    return effects.memory == 0 and not effects.cells


@compiled(forceinline=True)
def _set_load_slopes(effects, S, layout, terms, taken, by_sum):  # type: ignore[no-untyped-def]
    if effects is not None:
        if not effects.cells:
            load_gradients(terms.cells, taken.new, effects.by_load)
        set_load_slopes(S, layout, effects.by_load, effects.share, taken.solved.h, by_sum)


@compiled(forceinline=True)
def _carry_memory(effects, S, before, F, layout):  # type: ignore[no-untyped-def]
    if effects is not None:
        carry_memory(S, before, F, layout, effects.down)


@compiled(forceinline=True)
def _layout(effects, model, columns):  # type: ignore[no-untyped-def]
    """`Layout` of a Jacobian with so many columns."""
    n = model.load.shape[0]
    others = columns - n if columns > 0 else 0
    if effects is None:
        return Layout(n, others, 0, 0)
    return Layout(n, others, effects.memory, effects.parameters)


@compiled(forceinline=True)
def _begin(effects, single):  # type: ignore[no-untyped-def]
    """Put the memory before a single step where the step looks for it."""
    if effects is not None and single is not None:
        copy_into(effects.y[STATE : STATE + effects.memory], single.state[STATE : STATE + effects.memory])


@compiled(forceinline=True)
def _end(effects, single, S, layout, end):  # type: ignore[no-untyped-def]
    """Give out what only single steps do: memory, and the other rows of the Jacobian."""
    if effects is not None and single is not None:
        own = effects.own.shape[0]
        copy_into(end[AFTER : AFTER + own], effects.own)
        if layout.others > 0:
            n, rows, jacobian = layout.n, FIXED_ROWS + layout.memory, single.jacobian
            store_rows(S, S, 1.0, rows, 3, n, jacobian[3:STATE])
            store_rows(S, S, 1.0, rows, FIXED_ROWS + FORCE, n, jacobian[AFTER : AFTER + own])


@compiled(forceinline=True)
def _owned(common, maps, formulas, k, b, h, columns):  # type: ignore[no-untyped-def]
    """`Model`, `Effects` or None, and `Room` of model k under push b, of steps of length h."""
    model = _model_of(common, maps, k, h)
    effects = effects_of(formulas, k, b, maps.inertia[k], model, columns > 0)
    layout = _layout(effects, model, columns)
    S = first_blocks(layout, model.cells.rx, model.cells.ry)
    slopes = no_slopes(layout.memory, padded(layout.others))
    rows = np.zeros((MAX_CONTACTS, CONTACT_COLUMNS))
    before, F = (np.zeros_like(S), empty_blocks(layout, 2)) if columns > 0 else (S, S)
    return model, effects, Room(S, before, F, slopes, rows)


@compiled(forceinline=True)
def _sample_place(effects, push, sample):  # type: ignore[no-untyped-def]
    """Step in whose course a pose is wanted, and the place in it, 0 to 1."""
    if effects is None or effects.delay == 0.0:
        return push.sample_step[sample], push.sample_fraction[sample]
    return step_of(push.sample_time[sample] - effects.delay, push.h, push.tip.shape[0] - 1)


@compiled(forceinline=True)
def _set_rate(effects, push, sample, way, new, rate):  # type: ignore[no-untyped-def]
    """Set the velocity of a pose that is reported late; none where it lies outside of the push."""
    if effects is not None:
        time, h = push.sample_time[sample] - effects.delay, push.h
        moves = 0.0 < time < (push.tip.shape[0] - 1) * h * (1.0 + 1e-9)
        rate[0] = way.length * way.wx / h if moves else 0.0
        rate[1] = way.length * way.wy / h if moves else 0.0
        rate[2] = new[2] if moves else 0.0


@compiled(inline="always")
def _roll(model, effects, single, room, common, push, result, columns):  # type: ignore[no-untyped-def]
    """Simulate one push of one model into the result, whose derivatives have so many columns."""
    h, size, steps = push.h, common.size, push.tip.shape[0] - 1
    force_step = push.force_step
    n, derive = model.load.shape[0], columns > 0
    layout = _layout(effects, model, columns)
    remembers = layout.memory > 0
    block_rows = FIXED_ROWS + layout.memory
    S, before, F, slopes, rows = room
    _begin(effects, single)

    pose, twist = push.start_pose, push.start_twist
    v = (twist[0], twist[1], twist[2])
    turn = turn_by(0.25 * h * v[2])
    motion = Motion(pose[0], pose[1], pose[2], math.cos(pose[2]), math.sin(pose[2]), v, turn)
    past = (v, v, v)
    weights = (1.0, 0.0, 0.0)
    evaluations = sample = force_sample = 0
    failed = False

    for number in range(steps):
        terms = terms_at(effects, model, motion, number, h)
        guess = weighted(weights, past)
        taken = take_step(effects, model, common, push, number, terms, motion, guess, rows, derive)
        new, way, frame = taken.new, taken.way, taken.solved.frame
        weights = best_weights(new, past, size)
        past = (new, past[0], past[1])
        evaluations += taken.evaluations
        failed = failed or taken.evaluations > MAX_EVALUATIONS
        impulse = turned(frame.cos, frame.sin, taken.impulse[0], taken.impulse[1])
        force = (impulse[0] / h, impulse[1] / h)
        following = _moved(motion, taken, h)
        _remember(effects, following, force)

        first_sample = sample
        between = False
        while sample < result.poses.shape[0]:
            at, share = _sample_place(effects, push, sample)
            if at != number:
                break
            result.poses[sample, 0] = motion.x + share * way.length * way.wx
            result.poses[sample, 1] = motion.y + share * way.length * way.wy
            result.poses[sample, 2] = motion.theta + share * h * new[2]
            between = between or share < 1.0
            if result.rates.shape[0] > 0:
                _set_rate(effects, push, sample, way, new, result.rates[sample])
            sample += 1
        first_force = force_sample
        while force_sample < force_step.shape[0] and force_step[force_sample] == number:
            result.forces[force_sample, 0], result.forces[force_sample, 1] = force
            force_sample += 1

        if derive:
            wants_force = remembers or force_sample > first_force
            if between or wants_force:
                copy_into(before, S)
            by_sum = set_slopes(effects, single, model, push, number, terms, taken, slopes)
            carry(effects, S, layout, model, terms, taken, slopes, by_sum)
            if wants_force:
                fill_force(F, S, before, layout, slopes, by_sum, frame, force, h)
            if remembers:
                _carry_memory(effects, S, before, F, layout)
            for s in range(first_sample, sample):
                share = _sample_place(effects, push, s)[1]
                store_rows(S, before, share, block_rows, 0, n, result.d_poses[s])
            for s in range(first_force, force_sample):
                store_rows(F, F, 1.0, 2, 0, n, result.d_forces[s])
        _keep(effects, force)
        motion = following

    end = result.end
    end[0], end[1], end[2] = motion.x, motion.y, motion.theta
    end[3], end[4], end[5] = motion.v
    end[end.shape[0] - 1] = -1.0 if failed else float(evaluations)
    _end(effects, single, S, layout, end)


@compiled()
def rollout_one(job, common, maps, pushes, formulas, results):  # type: ignore[no-untyped-def]
    """Job number k B + b: push b of model k.

    Args:
        job: its number.
        common: fields of `Common`.
        maps: fields of `ReducedMaps`.
        pushes: fields of `JoinedPushes`.
        formulas: fields of `Formulas`, or None for the plain model.
        results: fields of `Results`, where those of the push are filled in.
    """
    common, maps, pushes, formulas, results = borrowed((common, maps, pushes, formulas, results))
    common, maps = Common(*common), ReducedMaps(*maps)
    pushes, results = JoinedPushes(*pushes), Results(*results)
    k, b = job // len(pushes.h), job % len(pushes.h)
    push, result = push_of(pushes, k, b), results_of(results, pushes, k, b)
    columns = result.d_poses.shape[2]
    owned = _owned(common, maps, formulas, k, b, push.h, columns)
    model, effects, room = borrowed(owned)
    _roll(model, effects, None, room, common, push, result, columns)
    keep(owned)


@compiled(parallel=True)
def _all_jobs(address, order, common, maps, pushes, formulas, results):  # type: ignore[no-untyped-def]
    for place in prange(len(order)):
        arguments = (order[place], common, maps, pushes, formulas, results)
        call_compiled(rollout_one, address, arguments)


def rollout_all(
    common: tuple[Any, ...],
    maps: tuple[Any, ...],
    pushes: JoinedPushes,
    formulas: Formulas | None,
    results: Results,
) -> None:
    """All models times all pushes, on all threads; `common` and `maps` as in `rollout_one`."""
    plain = None if formulas is None else tuple(formulas)
    arguments = (common, maps, tuple(pushes), plain, tuple(results))
    # A single job is not worth waking the other threads.
    if results.end.size == 7:
        rollout_one(0, *arguments)
    else:
        order = evenly_dealt(np.diff(pushes.tip_at), len(results.end))
        _all_jobs(address_of(rollout_one, (0, *arguments)), order, *arguments)


@compiled()
def single_steps(common, maps, formulas, drive, states, after, jacobian):  # type: ignore[no-untyped-def]
    """One step of K models, one after the other: waking other threads takes longer than the steps.

    A state is that of `Single`. The columns of a Jacobian are

        f_1 … f_n, m, s_x, s_y, J, mu_finger, x, y, θ, v_x, v_y, omega, the effects' parameters (as in a
        rollout), last force, memory, wrench, finger before and after (world).

    Args:
        common: fields of `Common`.
        maps: fields of `ReducedMaps`.
        formulas: fields of `Formulas`; its constants have one row, with the time before the step.
        drive: h, tip (2, 2), NaN for no finger, and wrench (5,), as in `Push`.
        states: (K, Z) before the step, Z = 8 + the effects' own memory.
        after: (K, Z + 1) result: state after the step, and the number of evaluations, negative if the step
            was not solved.
        jacobian: (K, Z, columns) result, or an array without columns for none.
    """
    given = borrowed((common, maps, formulas, drive, states, after, jacobian))
    common, maps, formulas, drive, states, after, jacobian = given
    common, maps = Common(*common), ReducedMaps(*maps)
    h, tip, wrench = drive
    columns, rates, row = jacobian.shape[2], after[:0, :3], wrench.reshape(1, 5)
    for k in range(len(states)):
        state, here = states[k], slice(k, k + 1)
        push = OnePush(h, tip, row, state[:3], state[3:STATE], _FIRST, _WHOLE, _WHOLE, _FIRST)
        poses, forces = after[here, :3], after[here, STATE:AFTER]
        result = Results(
            poses, rates, forces, jacobian[here, :3], jacobian[here, STATE:AFTER], after[k]
        )  # fmt: skip
        owned = _owned(common, maps, formulas, k, 0, h, columns)
        model, effects, room = borrowed(owned)
        _roll(model, effects, Single(state, jacobian[k]), room, common, push, result, columns)
        keep(owned)
