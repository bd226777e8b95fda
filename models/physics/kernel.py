"""One step of the model, and rollouts of many: the compiled loop, with the Jacobian carried along.

A step calls, in this order,

    supported    the loads, if part of the object may lie beyond the table's rim (`support.py`)
    terms_at     the terms that effects change, by their formulas at the state before the step (`terms.py`)
    take_step    free motion, applied forces, finger, contacts, the minimum, and the motion along it
    set_slopes   direct derivatives of the minimum's gradient and of the finger's impulse
    carry        the Jacobian over the step
    remember     the effects' memory for the next step

`_roll` repeats it. `rollout.py` calls `rollout_all`, `stepper.py` calls `single_steps`. A single step is a
rollout of one step, differentiated also with respect to what drives it.
"""

from __future__ import annotations

import math
import threading
from typing import Any, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from slipmap.models.physics.blocks import (
    FIXED_ROWS,
    add_mass_rows,
    add_rows,
    carry_direct,
    empty_blocks,
    fill_force,
    first_blocks,
    padded,
    pose_update,
    set_other_slopes,
    store_mass_rows,
    store_rows,
    twist_is_settled,
)
from slipmap.models.physics.compiled import (
    address_of,
    borrowed,
    call_compiled,
    compiled,
    keep,
)
from slipmap.models.physics.contact import CONTACT_COLUMNS, MAX_CONTACTS, SEPARATE
from slipmap.models.physics.friction import AFTER, FINGER_SETTLING, FORCE, STATE
from slipmap.models.physics.kernel_tools import (
    Common,
    FloatArray,
    Formulas,
    JoinedPushes,
    OnePush,
    ReducedMaps,
    Results,
    copy_into,
    evenly_dealt,
    joined,
    push_of,
    results_of,
    step_of,
    turn_by,
    turned,
)
from slipmap.models.physics.newton import LANES
from slipmap.models.physics.slopes import (
    Slopes,
    Taken,
    finger_impulse,
    no_slopes,
    set_input_slopes,
    set_step_slopes,
)
from slipmap.models.physics.step import (
    MAX_EVALUATIONS,
    REST,
    Applied,
    Frame,
    Step,
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
from slipmap.models.physics.support import (
    FIRST_FORCE,
    FIRST_POSE,
    REACHED,
    TIPS,
    TOUCHED,
    rim_of,
    spread_loads,
)
from slipmap.models.physics.terms import (
    Motion,
    add_effect_slopes,
    add_rim_slopes,
    at_work,
    carry_loads,
    effects_of,
    is_pulled,
    model_of,
    remember,
    rim_under,
    set_mass_slopes,
    supported,
    table_of,
    terms_at,
)
from slipmap.models.progress import cores

INPUTS = 9
"""Number of last columns of a single step's Jacobian, its drive: wrench (5), finger before and after (4)."""

# Sample of the pose and force of a single step: in the first step, at its end.
_FIRST, _END = np.zeros(1, np.int64), np.ones(1)


class Room(NamedTuple):
    """Storage of a rollout for derivatives and contacts."""

    # S, before, F: blocks after a step, before it, and of the finger's force, see `blocks.py`
    S: NDArray[np.float64]
    before: NDArray[np.float64]
    F: NDArray[np.float64]
    slopes: Slopes  # see `Slopes`
    contacts: NDArray[np.float64]  # (MAX_CONTACTS, CONTACT_COLUMNS)


@compiled(inline="always")
def take_step(  # type: ignore[no-untyped-def]
    model, common, push, number, terms, motion, guess, contacts, derive, settled
):
    """Solve one step; returns `Taken`.

    Args:
        model, common, push: `Model`, `Common`, `OnePush`.
        number: index of the step.
        terms, motion: `Terms` of the step, and `Motion` before it.
        guess: of the new twist.
        contacts: (MAX_CONTACTS, CONTACT_COLUMNS), filled in here.
        derive: whether derivatives are wanted.
        settled: whether the step before was `at_rest`, and no derivative of the twist is left.
    """
    h, v, cos, sin, quarter = push.h, motion.v, motion.cos, motion.sin, motion.quarter
    half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
    full_cos, full_sin = joined(half_cos, half_sin, half_cos, half_sin)
    middle_cos, middle_sin = joined(cos, sin, half_cos, half_sin)
    free = free_momentum(model.body, v, full_cos, full_sin)
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
    frame = Frame(middle_cos, middle_sin, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    count = 0
    if not math.isnan(tip0[0]) and not math.isnan(tip1[0]):
        rolling = common.radius * (push.tip[number + 1, 2] - push.tip[number, 2]) / h
        frame = middle_frame(motion.x, motion.y, cos, sin, quarter, v, h, tip0, tip1, rolling)
        gain = 0.0
        if bend_x != 0.0 or bend_y != 0.0:
            frame = bent_frame(frame, bend_x, bend_y, max(h, FINGER_SETTLING))
            gain += abs(frame.spring_x) + abs(frame.spring_y)
        if added_x != 0.0 or added_y != 0.0 or added_w != 0.0:
            gain += math.hypot(added_x, added_y) / body[0] + model.size * abs(added_w) / model.about_center
        count = touching(frame, v, h, common, contacts, gain)
    cone = terms.cone
    first = contact_of(contacts, 0, frame, v, h, cone)
    second = contact_of(contacts, 1, frame, v, h, cone)

    step = Step(terms.cells, inertia, star, h, first, second, count, cone, model.size, v, quarter, frame)
    new, minimum, evaluations = solve_step(step, guess, derive, settled)
    impulse, way = finger_impulse(first, second, minimum), way_of(new, cos, sin, h)
    return Taken(
        v, h, inertia, cone, frame, quarter, first, second, new, minimum, free, applied, impulse, way,
        evaluations,
    )  # fmt: skip


@compiled(inline="always")
def _moved(motion, taken, h):  # type: ignore[no-untyped-def]
    """`Motion` after a step."""
    way = taken.way
    cos, sin = joined(way.cos, way.sin, way.half_cos, way.half_sin)
    x, y = motion.x + way.length * way.wx, motion.y + way.length * way.wy
    return Motion(x, y, motion.theta + h * taken.new[2], cos, sin, taken.new, way.quarter)


@compiled(forceinline=True)
def _set_last_inputs(inputs, push, number, taken, layout, slopes):  # type: ignore[no-untyped-def]
    if inputs is not None:
        set_input_slopes(taken, push.wrench[number], layout.others - inputs, slopes.other)


@compiled(inline="always")
def set_slopes(  # type: ignore[no-untyped-def]
    effects, rim, inputs, model, layout, push, number, motion, terms, taken, slopes
):
    """Set the `Slopes` of a step from a `Motion`; `model` has the loads that the table carries."""
    set_step_slopes(taken, model.load_sum, slopes)
    _set_last_inputs(inputs, push, number, taken, layout, slopes)
    add_rim_slopes(rim, effects, motion, terms, taken, slopes)
    add_effect_slopes(effects, rim, model, terms, taken, slopes)


@compiled(inline="always")
def carry(effects, rim, S, layout, model, terms, taken, slopes):  # type: ignore[no-untyped-def]
    """Carry the state rows of the Jacobian over a step, in place."""
    pose = pose_update(taken.way, taken.h)
    first = carry_loads(effects, rim, S, layout, model, terms, taken, slopes, pose)
    set_other_slopes(S, layout, slopes.other)
    set_mass_slopes(rim, S, layout)
    carry_direct(S, first, layout, slopes.state, taken.minimum, pose, taken.h)


@compiled(forceinline=True)
def at_rest(taken, push, effects):  # type: ignore[no-untyped-def]
    """Whether the object rests before and after a `Taken` step, untouched, for any parameters close by."""
    first, second = taken.minimum.first, taken.minimum.second
    untouched = first.state == SEPARATE and second.state == SEPARATE and push.wrench.shape[0] == 0
    still = taken.v == REST and taken.new == REST
    return still and untouched and not is_pulled(effects)


@compiled(forceinline=True)
def _sample_place(push, sample, delay):  # type: ignore[no-untyped-def]
    """Step in which a sampled pose falls, with the tracker's delay, and the fraction of that step, 0 to 1."""
    if delay == 0.0:
        return push.sample_step[sample], push.sample_fraction[sample]
    return step_of(push.sample_time[sample] - delay, push.h, push.tip.shape[0] - 1)


@compiled()
def _set_rate(rate, push, sample, delay, dx, dy, dtheta):  # type: ignore[no-untyped-def]
    """Set the velocity of a sampled pose from its motion in the step; zero outside the push."""
    time, h = push.sample_time[sample] - delay, push.h
    inside = 0.0 < time < (push.tip.shape[0] - 1) * h * (1.0 + 1e-9)
    rate[0], rate[1], rate[2] = (dx / h, dy / h, dtheta / h) if inside else (0.0, 0.0, 0.0)


@compiled(forceinline=True)
def _store_masses(rim, S, before, share, layout, out):  # type: ignore[no-untyped-def]
    """Write the rows of the masses into out (wanted, n), if any are nonzero."""
    if rim is None:
        return
    if rim.flags[TOUCHED] != 0:
        store_mass_rows(S, before, share, FIXED_ROWS + layout.memory, layout, out)


@compiled(forceinline=True)
def _add_mass_forces(rim, F, part, begins, layout, out):  # type: ignore[no-untyped-def]
    """Add a part of the masses' rows of the force to out (2, n), if any are nonzero."""
    if rim is None:
        return
    if begins:
        out[:] = 0.0
    if rim.flags[TOUCHED] != 0:
        add_mass_rows(F, part, 2, layout, out)


@compiled(forceinline=True)
def _store_state_masses(rim, S, layout, out):  # type: ignore[no-untyped-def]
    """Write the masses' rows of twist and memory into out (Z, n); `_roll` writes the others."""
    if rim is None:
        return
    if rim.flags[TOUCHED] != 0:
        rows, size = FIXED_ROWS + layout.memory, LANES
        moved = S[3 * size :]
        store_mass_rows(moved, moved, 1.0, rows, layout, out[3:STATE])
        own = S[(FIXED_ROWS + FORCE) * size :]
        store_mass_rows(own, own, 1.0, rows, layout, out[AFTER:])


@compiled(forceinline=True)
def _note_samples(rim, poses, forces):  # type: ignore[no-untyped-def]
    """When a push first comes near the rim, record how many poses and forces were sampled before."""
    if rim is None:
        return
    if rim.flags[TOUCHED] != 0 and rim.found[REACHED] == 0.0:
        rim.found[REACHED] = 1.0
        rim.found[FIRST_POSE] = poses
        rim.found[FIRST_FORCE] = forces


@compiled(forceinline=True)
def _give_rim(rim, model, motion, time, result):  # type: ignore[no-untyped-def]
    """Check the object's final pose for tipping, and write what was found into the result."""
    if rim is None:
        return
    if rim.found[TIPS] == np.inf:
        supported(rim, model, motion, time)
    copy_into(result.rim, rim.found)


@compiled(inline="always")
def _owned(common, maps, formulas, table, k, b, h, columns, memory):  # type: ignore[no-untyped-def]
    """`Model` k under push b with steps of length h, `Rim`, the results of `effects_of`, and `Room`."""
    model = model_of(common, maps, k, h)
    effects, plain_layout, delay = effects_of(formulas, k, b, model, columns, memory)
    rim, layout = rim_under(table_of(table, k, b), maps.mass[k], model, plain_layout)
    S = first_blocks(layout, model.cells.rx, model.cells.ry)
    before, F = (np.zeros_like(S), empty_blocks(layout, 2)) if columns > 0 else (S, S)
    slopes = no_slopes(layout.memory, padded(layout.others))
    room = Room(S, before, F, slopes, np.zeros((MAX_CONTACTS, CONTACT_COLUMNS)))
    return model, rim, effects, layout, delay, room


@compiled(inline="always")
def _roll(things, inputs, common, push, result):  # type: ignore[no-untyped-def]
    """Simulate one push of one model into its result.

    Args:
        things: results of `_owned`.
        inputs: number of last columns of the Jacobian that belong to the drive of the first step, or None.
        common, push, result: `Common`, `OnePush`, `Results` of the push.
    """
    model, rim, effects, layout, delay, room = things
    S, before, F, slopes, contacts = room
    h, size, steps = push.h, common.size, push.tip.shape[0] - 1
    force_first, force_last = push.force_first, push.force_last
    n, derive, remembers = layout.n, layout.others > 0, layout.memory > 0

    pose, twist = push.start_pose, push.start_twist
    v = (twist[0], twist[1], twist[2])
    turn = turn_by(0.25 * h * v[2])
    motion = Motion(pose[0], pose[1], pose[2], math.cos(pose[2]), math.sin(pose[2]), v, turn)
    past = (v, v, v)
    weights = (1.0, 0.0, 0.0)
    evaluations = sample = force_sample = 0
    failed = settled = False

    for number in range(steps):
        here = supported(rim, model, motion, number * h)
        _note_samples(rim, sample, force_sample)
        terms = terms_at(effects, rim, here, motion, number, h)
        guess = weighted(weights, past)
        taken = take_step(here, common, push, number, terms, motion, guess, contacts, derive, settled)
        new, way, frame = taken.new, taken.way, taken.frame
        weights = best_weights(new, past, size)
        past = (new, past[0], past[1])
        evaluations += taken.evaluations
        failed = failed or taken.evaluations > MAX_EVALUATIONS
        impulse = turned(frame.cos, frame.sin, taken.impulse[0], taken.impulse[1])
        force = (impulse[0] / h, impulse[1] / h)
        following = _moved(motion, taken, h)
        rests = at_rest(taken, push, effects)
        steady, settled = rests and settled, rests and (settled or not derive)

        dx, dy, dtheta = way.length * way.wx, way.length * way.wy, h * new[2]
        first_sample = sample
        between = False
        while sample < result.poses.shape[0]:
            at, share = _sample_place(push, sample, delay)
            if at != number:
                break
            result.poses[sample, 0] = motion.x + share * dx
            result.poses[sample, 1] = motion.y + share * dy
            result.poses[sample, 2] = motion.theta + share * dtheta
            between = between or share < 1.0
            if result.rates.shape[0] > 0:
                _set_rate(result.rates[sample], push, sample, delay, dx, dy, dtheta)
            sample += 1
        # Forces that this step is part of; those before are complete.
        next_force = force_sample
        while next_force < force_first.shape[0] and force_first[next_force] <= number:
            if force_first[next_force] == number:
                result.forces[next_force, 0] = result.forces[next_force, 1] = 0.0
            part = 1.0 / (force_last[next_force] - force_first[next_force] + 1)
            result.forces[next_force, 0] += part * force[0]
            result.forces[next_force, 1] += part * force[1]
            next_force += 1

        if derive:
            wants_force = remembers or next_force > force_sample
            now = at_work(rim, S, layout)
            if between or wants_force:
                copy_into(at_work(rim, before, layout), now)
            if not steady:
                set_slopes(
                    effects, rim, inputs, here, layout, push, number, motion, terms, taken, slopes
                )  # fmt: skip
                carry(effects, rim, now, layout, here, terms, taken, slopes)
                settled = rests and twist_is_settled(now, layout)
            if wants_force and not (steady and remembers):
                fill_force(F, now, before, layout, slopes, frame, force, h)
            for s in range(first_sample, sample):
                share = _sample_place(push, s, delay)[1]
                store_rows(S, before, share, FIXED_ROWS + layout.memory, 0, n, result.d_poses[s])
                _store_masses(rim, S, before, share, layout, result.mass_poses[s])
            for s in range(force_sample, next_force):
                part, begins = 1.0 / (force_last[s] - force_first[s] + 1), force_first[s] == number
                add_rows(F, part, begins, 2, n, result.d_forces[s])
                _add_mass_forces(rim, F, part, begins, layout, result.mass_forces[s])
        while force_sample < next_force and force_last[force_sample] == number:
            force_sample += 1
        remember(effects, at_work(rim, S, layout), before, F, layout, following, force)
        motion = following

    _give_rim(rim, model, motion, steps * h, result)
    end = result.end
    end[0], end[1], end[2] = motion.x, motion.y, motion.theta
    end[3], end[4], end[5] = motion.v
    end[end.shape[0] - 1] = -1.0 if failed else float(evaluations)


@compiled(nogil=True)
def rollout_one(job, common, maps, pushes, formulas, table, results):  # type: ignore[no-untyped-def]
    """Run job k B + b: push b of model k.

    Args:
        job: its number.
        common: fields of `Common`.
        maps: fields of `ReducedMaps`.
        pushes: fields of `JoinedPushes`.
        formulas: fields of `Formulas`, or None for the plain model.
        table: (K, B, 7) `Rim.top`, or (1, 1, 7) for all, or None if cells are supported everywhere.
        results: fields of `Results`; those of the push are filled in.
    """
    given = borrowed((common, maps, pushes, formulas, table, results))
    common, maps, pushes, formulas, table, results = given
    common, maps = Common(*common), ReducedMaps(*maps)
    pushes, results = JoinedPushes(*pushes), Results(*results)
    k, b = job // len(pushes.h), job % len(pushes.h)
    push, result = push_of(pushes, k, b), results_of(results, pushes, k, b)
    columns = result.d_poses.shape[2]
    owned = _owned(common, maps, formulas, table, k, b, push.h, columns, maps.mu[:0])
    _roll(borrowed(owned), None, common, push, result)
    keep(owned)


@compiled(parallel=True, nogil=True)
def _all_jobs(address, order, common, maps, pushes, formulas, table, results):  # type: ignore[no-untyped-def]
    for place in prange(len(order)):
        arguments = (order[place], common, maps, pushes, formulas, table, results)
        call_compiled(rollout_one, address, arguments)


@compiled(nogil=True)
def _one_by_one(address, order, common, maps, pushes, formulas, table, results):  # type: ignore[no-untyped-def]
    for place in range(len(order)):
        arguments = (order[place], common, maps, pushes, formulas, table, results)
        call_compiled(rollout_one, address, arguments)


def rollout_all(
    common: tuple[Any, ...],
    maps: tuple[Any, ...],
    pushes: JoinedPushes,
    formulas: Formulas | None,
    table: FloatArray | None,
    results: Results,
) -> None:
    """Roll out all models under all pushes; `common`, `maps`, `table` as in `rollout_one`.

    They take all cores, or one where tasks side by side work on the others.
    """
    plain = None if formulas is None else tuple(formulas)
    arguments = (common, maps, tuple(pushes), plain, table, tuple(results))
    # A single job is not worth waking the other threads.
    if results.end.size == 7:
        rollout_one(0, *arguments)
    else:
        order = evenly_dealt(np.diff(pushes.tip_at), len(results.end))
        address = address_of(rollout_one, (0, *arguments))
        if not cores().any_free:
            _one_by_one(address, order, *arguments)
            return
        with _ALL_THREADS:
            _all_jobs(address, order, *arguments)


_ALL_THREADS = threading.Lock()
"""Held by the Python thread whose rollouts run: not every threading layer of Numba takes turns by itself."""


@compiled()
def loads_at(common, maps, table, poses, factors):  # type: ignore[no-untyped-def]
    """Factors φ_i from the cells' weights to the loads that the table carries, for K models at G poses.

    Args:
        common: fields of `Common`.
        maps: fields of `ReducedMaps`.
        table: (1, 1, 7) `Rim.top`.
        poses: (G, 3), world.
        factors: (K, G, n) result, φ_i.
    """
    common, maps = Common(*common), ReducedMaps(*maps)
    for k in range(factors.shape[0]):
        model = model_of(common, maps, k, 1.0)
        rim = rim_of(table[0, 0], maps.mass[k], model.body, model.cells, model.cell_width, model.size, False)
        for g in range(poses.shape[0]):
            x, y, turn = poses[g, 0], poses[g, 1], poses[g, 2]
            spread_loads(rim, model.body, x, y, math.cos(turn), math.sin(turn))
            copy_into(factors[k, g], rim.factor[: factors.shape[2]])


@compiled()
def single_steps(  # type: ignore[no-untyped-def]
    common, maps, formulas, table, drive, states, after, jacobian, by_mass, rim_found
):
    """Take one step of K models in sequence, since waking other threads takes longer than the steps.

    The state is x, y, θ (world), v_x, v_y, omega (object frame), the finger's last force (world, N), and the
    rest of the effects' memory. The columns of its Jacobian are, in this order,

        f_1 … f_n, m, s_x, s_y, J, mu_finger, x, y, θ, v_x, v_y, omega, the effects' parameters (as in a
        rollout), last force, memory, wrench, finger before and after (world).

    Args:
        common: fields of `Common`.
        maps: fields of `ReducedMaps`.
        formulas: fields of `Formulas`; its constants have one row, with the time before the step.
        table: (1, 1, 7) `Rim.top`, or None.
        drive: h, tip (2, 3) with its angle, NaN for no finger, and wrench (5,), as in `Push`.
        states: (K, Z) before the step, Z = 8 + the rest of the effects' memory.
        after: (K, Z + 1) result: state after the step, and the number of evaluations, negative if the step
            was not solved.
        jacobian: (K, Z, columns) result, or an array without columns for none.
        by_mass: (K, Z, n) result: derivatives with respect to the masses through shifting loads, zero if
            loads do not shift; or an array without columns.
        rim_found: (K, RIM_RESULTS) result, or an array without columns if there is no table.

    Returns:
        Index of the first model whose step was not solved, or -1.
    """
    given = borrowed((common, maps, formulas, table, drive, states, after, jacobian, by_mass, rim_found))
    common, maps, formulas, table, drive, states, after, jacobian, by_mass, rim_found = given
    common, maps = Common(*common), ReducedMaps(*maps)
    h, tip, wrench = drive
    columns, rates, row, Z = jacobian.shape[2], after[:0, :3], wrench.reshape(1, 5), states.shape[1]
    for k in range(len(states)):
        state, here = states[k], slice(k, k + 1)
        push = OnePush(h, tip, row, state[:3], state[3:STATE], _FIRST, _END, _END, _FIRST, _FIRST)
        # A rollout's poses and forces go to the rows of the state that hold them.
        poses, forces = after[here, :3], after[here, STATE:AFTER]
        d_poses, d_forces = jacobian[here, :3], jacobian[here, STATE:AFTER]
        result = Results(
            poses, rates, forces, d_poses, d_forces, after[k], rim_found[k], by_mass[here, :3],
            by_mass[here, STATE:AFTER],
        )  # fmt: skip
        owned = _owned(common, maps, formulas, table, k, 0, h, columns, state[STATE:])
        things = borrowed(owned)
        _roll(things, INPUTS, common, push, result)
        _, rim, effects, layout, _, room = things
        copy_into(after[k, AFTER:Z], effects.own)
        if columns > 0:
            S, rows, n = room.S, FIXED_ROWS + layout.memory, layout.n
            store_rows(S, S, 1.0, rows, 3, n, jacobian[k, 3:STATE])
            store_rows(S, S, 1.0, rows, FIXED_ROWS + FORCE, n, jacobian[k, AFTER:])
            _store_state_masses(rim, S, layout, by_mass[k])
        keep(owned)
        solved = after[k, Z] >= 0.0
        for i in range(Z):
            solved = solved and math.isfinite(after[k, i])
        if not solved:
            return k
    return -1
