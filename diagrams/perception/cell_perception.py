"""Perception as a block: depth pictures in, the object's cells and pose out.

A thread or a worker processes the pictures while the world moves on.
"""

import gc
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.sensors import ImageDepth32F

from slipmap.diagrams.perception.camera import CameraConfig
from slipmap.diagrams.perception.sight import view_from
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.models.perception.first_look import (
    FirstPicture,
    ObjectNotSeen,
    first_look,
    median_depth,
    object_center,
)
from slipmap.models.perception.object_mask import Hull, Mask, PictureHistory, draw_hulls, readings
from slipmap.models.perception.pinhole_camera import DepthImage, NoTable, PinholeCamera, View, pixel_size
from slipmap.models.perception.pose_tracking import load_kernels, outline_offsets, track
from slipmap.models.perception.seen_object import (
    ObservedPose,
    Reason,
    Rests,
    SeenObject,
    mean_offsets,
    sharpened,
)
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.settings import check_whole

FRAMES = 15  # pictures of the object at rest in the first look; an odd number keeps its edges sharp
_KNOWN_AFTER = 0.5  # of the time between two pictures, allowed for processing one
OLD = 3  # missing pictures after which the last one is too old
_NO_JOB: tuple[Any, tuple[DepthImage, ...]] = (None, ())  # and pictures that were not sent with it
_STILL = np.array([1e-3, 1e-3, np.deg2rad(0.5)])  # m, m, rad between two pictures of an object at rest
_TRIED_EVERY = 5  # pictures; this many of the first and of the last are compared
_AT_REST = 1.0  # pixels by which the object may seem to move between them


@dataclass(frozen=True, eq=False)
class _Memory:
    """State: pictures collected for the first look, its result, and the observations since.

    `doubtful` is set after a torn picture: later ones may be torn in the same place without repeating a row.
    """

    observed: ObservedPose
    history: PictureHistory = field(default_factory=PictureHistory)
    frames: tuple[DepthImage, ...] = ()
    seen: SeenObject | None = None
    first: FirstPicture | None = None
    last_pose: FloatArray | None = None
    doubtful: bool = False
    rests: Rests | None = None  # where the object rested; None keeps the outline as it is
    grid: CellGrid | None = None  # its cells, with the outline as seen at these places


@dataclass(frozen=True, eq=False)
class _Glance:
    """Values of the inputs at one time; `picture` (H, W) is None before the first."""

    picture: DepthImage | None
    X_WC: bytes
    arm: Sequence[Hull] | None
    age: float
    time: float


@dataclass(frozen=True)
class _Eye:
    """Processing of pictures.

    `oldest` (s) is the largest age of the newest picture, `places` the number of places where the object
    rested from which its outline is made.
    """

    camera: PinholeCamera
    cells: int
    oldest: float
    places: int

    def looked(self, memory: _Memory, glance: _Glance) -> _Memory:
        """The state after another look."""
        camera, picture, age, time = self.camera, glance.picture, glance.age, glance.time
        if picture is None or not np.isfinite(age):
            return replace(memory, observed=ObservedPose.unseen("no picture", time))
        if picture.shape != (camera.height, camera.width):
            return replace(memory, observed=ObservedPose.unseen("corrupt picture", time))
        view = view_from(camera, glance.X_WC)
        image = readings(picture)
        blocked: Mask | None = None if glance.arm is None else draw_hulls(glance.arm, view)
        fault, new, history = memory.history.judged(image, time - age, time, self.oldest, blocked)
        if fault:
            doubtful = memory.doubtful or fault == "torn picture"
            return replace(memory, observed=ObservedPose.unseen(fault, time), doubtful=doubtful)
        if not new:
            return memory
        memory = replace(memory, history=history)
        if memory.seen is None:
            return self._first_look(memory, image, view, blocked, time - age)
        assert memory.last_pose is not None
        observed = track(image, view, memory.seen, memory.last_pose, blocked, time - age)
        if not observed.valid and history.spoilt(image, blocked):
            observed = replace(observed, reason="corrupt picture")
        if not observed.valid:
            return replace(memory, observed=observed)
        moved = np.abs(observed.pose - memory.last_pose)
        doubtful = memory.doubtful and bool((moved > _STILL).any())
        last = observed.pose
        if doubtful:
            observed = ObservedPose.unseen("torn picture", time)
        memory = replace(memory, observed=observed, last_pose=last, doubtful=doubtful)
        return self._outlined(memory, image, view, blocked) if observed.valid else memory

    def _outlined(self, memory: _Memory, image: DepthImage, view: View, blocked: Mask | None) -> _Memory:
        """With the outline as seen in a picture of the object at its last pose, if it adds to the outline."""
        seen, rests, pose = memory.seen, memory.rests, memory.last_pose
        assert seen is not None and pose is not None
        if rests is None or len(rests.offsets) >= self.places or not rests.wants(pose):
            return memory
        after = rests.with_look(pose, outline_offsets(image, view, seen, pose, blocked))
        if len(after.offsets) == len(rests.offsets):
            return replace(memory, rests=after)
        return replace(memory, rests=after, grid=sharpened(seen, after.offsets, pixel_size(view)))

    def looked_in_thread(self, memory: _Memory, glance: _Glance) -> _Memory:
        """Like `looked`, with Python's garbage collector disabled.

        The collector could free anything in this thread, such as the diagram of an earlier run, whose
        renderer must be freed in the thread that made it. At the end the youngest generation is collected
        here: otherwise the collector, whose counters kept running, would start a full collection as soon as
        it is enabled.
        """
        enabled = gc.isenabled()
        gc.disable()
        try:
            return self.looked(memory, glance)
        finally:
            if enabled:
                gc.collect(0)
                gc.enable()

    def _first_look(
        self, memory: _Memory, image: DepthImage, view: View, blocked: Mask | None, time: float
    ) -> _Memory:
        frames = (*memory.frames, image)
        observed = replace(memory.observed, time=time)
        if len(frames) < FRAMES:
            return replace(memory, observed=observed, frames=frames)
        later = frames[_TRIED_EVERY:]
        try:
            begin, end = (
                object_center(part, view, blocked) for part in (frames[:_TRIED_EVERY], frames[-_TRIED_EVERY:])
            )
            moved = float(np.hypot(*(end - begin)))
            if moved > _AT_REST:
                detail = f"the object on the table moved by {moved:.1f} pixels during the first look"
                return replace(memory, observed=ObservedPose.unseen("no object", time, detail), frames=later)
            seen = first_look(frames, view, self.cells, blocked)
        except (ObjectNotSeen, NoTable) as error:
            reason: Reason = error.reason if isinstance(error, ObjectNotSeen) else "no object"
            return replace(memory, observed=ObservedPose.unseen(reason, time, str(error)), frames=later)
        observed = track(image, view, seen, seen.first_pose, blocked, time)
        history = memory.history.learned(frames, blocked)
        hidden = np.zeros(image.shape, bool) if blocked is None else blocked
        first = FirstPicture(
            median_depth(frames), view.X_WC, hidden, self.cells, history.noisy, history.missing
        )
        looks = [outline_offsets(frame, view, seen, seen.first_pose, blocked) for frame in frames]
        rests = Rests((mean_offsets(looks),), seen.first_pose)
        grid = sharpened(seen, rests.offsets, pixel_size(view))
        return _Memory(
            observed, history, seen=seen, first=first, last_pose=seen.first_pose, rests=rests, grid=grid
        )


class CellPerception(PythonSystem):
    """Finds the object on the table, divides it into cells, and tracks its pose from picture to picture.

    Inputs: `depth_image`, an ImageDepth32F; `X_WC`, a RigidTransform; `arm_position` (optional), (7,) joint
    angles used to mask the arm in the picture; `image_age` (optional), (1,) time since the picture was taken,
    s, else 0. Outputs: `object_pose`, an `ObservedPose`; `cell_grid`, a `CellGrid`, or None until the first
    look is over; `seen_object`, a `SeenObject` with heights, or None; `first_picture`, the `FirstPicture`
    that it is derived from, or None; `rests`, a `Rests`, or None.

    The inputs are read at the camera's rate. The result appears half a period later, with the time at which
    it was seen. The first look takes `FRAMES` pictures during which the object does not move; it continues
    until it has them, with the arm away from the object. It defines the object frame: origin at the centroid
    of the footprint's area, axes parallel to the world's. Until then the pose is invalid, with the reason "no
    object" or "occluded".

    At each new place where the object rests, its outline is seen again, and that of `cell_grid` becomes more
    exact; the cells stay, and so does `seen_object`, to which poses are fitted.

    A picture seen before, as shown by its age or because all of its rows are repeated, gives no new
    information; after three missing pictures the pose becomes invalid. It is also invalid if the picture is
    torn, that is, contains rows of an earlier one, and from then on until the object rests; or if a tenth
    more pixels than usual have no reading. A camera without noise repeats rows whenever nothing moves: the
    first look determines whether this one does, and until then torn and repeated pictures are not detected.

    Args:
        cells: rough number of cells, see `cells_from_polygon`.
        arm_hulls: hulls around the arm for joint angles (7,), rad, such as `ArmHulls`; None if the arm is
            never in the picture.
        worker: processes the pictures and skips those that come meanwhile. If None, a thread of this process,
            for which the simulation waits if it is not done in time.
        known: the first picture of an earlier process, the (3,) pose at which it last saw the object, and the
            offsets of the outline, as in `Rests`; with them there is no first look. Without any offsets the
            outline stays that of the first picture.
        places: number of places where the object rests from which its outline is made.

    Raises:
        ValueError: a number of cells below 1.

    Example:
        >>> import slipmap
        >>> perception = slipmap.CellPerception(slipmap.Scenario().camera)
        >>> [perception.get_output_port(i).get_name() for i in range(perception.num_output_ports())]
        ['object_pose', 'cell_grid', 'seen_object', 'first_picture', 'rests']
    """

    def __init__(
        self,
        camera: CameraConfig | None = None,
        cells: int = 60,
        arm_hulls: Callable[[FloatArray], Sequence[Hull]] | None = None,
        worker: Executor | None = None,
        known: tuple[FirstPicture, FloatArray, Sequence[FloatArray]] | None = None,
        places: int = sys.maxsize,
    ) -> None:
        super().__init__()
        check_whole("CellPerception: cells", cells, 1)
        load_kernels()
        config = camera or CameraConfig()
        self._eye = _Eye(config.intrinsics, cells, OLD / config.rate, places)
        self._waits = worker is None
        self._worker = worker or ThreadPoolExecutor(1, "pictures")
        self._arm_hulls = arm_hulls
        self._image = self.DeclareAbstractInputPort("depth_image", AbstractValue.Make(ImageDepth32F()))
        self._X_WC = self.DeclareAbstractInputPort("X_WC", AbstractValue.Make(RigidTransform()))
        self._arm = self.DeclareVectorInputPort("arm_position", 7)
        self._age = self.DeclareVectorInputPort("image_age", 1)
        start = _Memory(ObservedPose.unseen("no object", detail="too few pictures came for the first look"))
        if known is not None:
            first, last_pose, offsets = known
            history = PictureHistory(noisy=first.noisy, missing=first.missing)
            seen = first.seen(self._eye.camera)
            start = replace(
                start, history=history, seen=seen, first=first, last_pose=last_pose,
                rests=Rests(tuple(offsets), last_pose) if len(offsets) else None,
                grid=first.grid(self._eye.camera, offsets),
            )  # fmt: skip
        self._memory = memory = self.DeclareAbstractState(held(start))
        self._job = self.DeclareAbstractState(held(_NO_JOB))
        self.declare_output_of("object_pose", memory, lambda memory: memory.observed)
        self.declare_output_of("cell_grid", memory, lambda memory: memory.grid)
        self.declare_output_of("seen_object", memory, lambda memory: memory.seen)
        self.declare_output_of("first_picture", memory, lambda memory: memory.first)
        self.declare_output_of("rests", memory, lambda memory: memory.rests)
        period = 1.0 / config.rate
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._look)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, _KNOWN_AFTER * period, self._take)

    def _look(self, context: Any, state: Any) -> None:
        self._take(context, state)
        if read(state, self._job)[0] is not None:
            return
        memory: _Memory = read(state, self._memory)
        # Pictures collected for the first look are large; a worker gets them only when there are enough.
        few = memory.seen is None and len(memory.frames) + 1 < FRAMES
        kept = memory.frames if few else ()
        sent = replace(memory, frames=()) if few else memory
        look = self._eye.looked_in_thread if self._waits else self._eye.looked
        job = self._worker.submit(look, sent, self._glance(context))
        replace_held(state, self._job, (job, kept))

    def _take(self, context: Any, state: Any) -> None:
        """Store the result of the last look, if it is ready."""
        job, kept = read(context, self._job)
        if job is None or not (self._waits or job.done()):
            return
        memory: _Memory = job.result()
        replace_held(state, self._memory, replace(memory, frames=(*kept, *memory.frames)) if kept else memory)
        replace_held(state, self._job, _NO_JOB)

    def _glance(self, context: Any) -> _Glance:
        picture: Any = self._image.Eval(context)
        X_WC: Any = self._X_WC.Eval(context)
        hulls = None
        if self._arm_hulls is not None and self._arm.HasValue(context):
            hulls = self._arm_hulls(np.asarray(self._arm.Eval(context)))
        return _Glance(
            picture.data[:, :, 0].copy() if picture.width() * picture.height() else None,
            X_WC.GetAsMatrix4().tobytes(),
            hulls,
            float(self._age.Eval(context)[0]) if self._age.HasValue(context) else 0.0,
            context.get_time(),
        )
