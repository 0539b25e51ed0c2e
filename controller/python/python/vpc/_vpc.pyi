import os
from collections.abc import Callable, Sequence
from typing import Literal, Protocol, final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .rows import Occlusion, PandaReport, PandaRow, Row

_Array = NDArray[np.float64]
_Path = str | os.PathLike[str]

__version__: str

class _Law(Protocol):
    def __call__(self, points: _Array, time_s: float, /) -> ArrayLike: ...

class _LateLaw(Protocol):
    def __call__(self, points: _Array | None, time_s: float, /) -> ArrayLike: ...

@final
class Scene:
    @staticmethod
    def load(path: _Path) -> Scene: ...
    @staticmethod
    def parse(text: str, path: str = "scene.toml") -> Scene: ...
    @staticmethod
    def built_in(name: Literal["paper-sim", "paper-robot", "tags-robot"]) -> Scene: ...
    def with_arm(self, path: _Path | None) -> Scene: ...
    @property
    def joint_limits(self) -> _Array | None: ...
    @property
    def name(self) -> str: ...
    @property
    def size(self) -> tuple[float, float]: ...
    @property
    def focal(self) -> tuple[float, float]: ...
    @property
    def center(self) -> tuple[float, float]: ...
    @property
    def rate_hz(self) -> float: ...
    @property
    def pattern(self) -> _Array: ...
    @property
    def goal(self) -> _Array: ...
    @property
    def goal_pose(self) -> _Array: ...
    @property
    def velocity_limits(self) -> _Array: ...
    @property
    def acceleration_limits(self) -> _Array: ...
    @property
    def time_s(self) -> float: ...
    @property
    def convergence_px(self) -> float: ...
    @property
    def occlusions(self) -> list[Occlusion]: ...
    def starts(self, count: int = 100, seed: int = 1000) -> _Array: ...

def read_starts(path: _Path) -> _Array: ...
@final
class Recall:
    @property
    def twist(self) -> _Array: ...
    @property
    def way_point(self) -> _Array: ...
    @property
    def twist_variance(self) -> _Array | None: ...
    @property
    def way_point_variance(self) -> _Array | None: ...
    @property
    def samples(self) -> list[int]: ...
    @property
    def distance(self) -> float | None: ...
    @property
    def correlation(self) -> float | None: ...

@final
class Memory:
    @staticmethod
    def load(path: _Path, scene: Scene) -> Memory: ...
    @staticmethod
    def build(
        scene: Scene,
        trajectories: int = 50,
        seed: int = 1,
        *,
        variance: bool = False,
        progress: Callable[[int, int], object] | None = None,
    ) -> Memory: ...
    def save(self, path: _Path) -> None: ...
    def __len__(self) -> int: ...
    def neighbours(self, points: ArrayLike, k: int = 1) -> Recall: ...
    def gaussian_process(self, points: ArrayLike) -> Recall: ...

@final
class Step:
    @property
    def twist(self) -> _Array: ...
    @property
    def way_point(self) -> _Array | None: ...
    @property
    def elbow(self) -> float: ...
    @property
    def state(self) -> Literal["moving", "arrived", "holding", "braking", "disarmed"]: ...
    @property
    def hold(self) -> str | None: ...
    @property
    def status(
        self,
    ) -> Literal[
        "idle", "converged", "iteration limit", "stalled", "infeasible", "numerical failure"
    ]: ...
    @property
    def recalled(self) -> str: ...
    @property
    def iterations(self) -> int: ...
    @property
    def cost(self) -> float: ...
    @property
    def violation_px(self) -> float: ...
    @property
    def clearance_px(self) -> float: ...
    @property
    def error_px(self) -> float: ...

@final
class Foreseen:
    @property
    def outcome(self) -> Literal["arrives", "nears", "unknown"]: ...
    @property
    def cost(self) -> float | None: ...
    @property
    def steps(self) -> float | None: ...
    @property
    def error_px(self) -> float | None: ...
    @property
    def guide(self) -> str: ...
    @property
    def every(self) -> int: ...
    @property
    def tried(self) -> int: ...
    @property
    def simulated(self) -> int: ...
    @property
    def path(self) -> _Array: ...

@final
class Controller:
    def __new__(
        cls,
        scene: Scene,
        memory: Memory | None = None,
        strategy: str = "foresight",
        *,
        np: int = 3,
        step_s: float = 0.033,
        nc: int = 1,
        iterations: int = 10,
        tolerance: float = 1e-3,
        intersample: bool = True,
        model: Literal["target-depth", "area-depth", "pose"] = "pose",
        foresight_steps: int = 150,
        trigger_px: float = 20.0,
        hysteresis: float = 2.0,
        margin_px: float = 0.0,
        change_share: float = 0.03,
        filter_s: float = 0.15,
        filter_px: float = 1.0,
        delay_compensation: bool = True,
        drift_compensation: bool = True,
        blind_s: float = 1.0,
        brake_s: float = 0.0,
        # The gain of ibvs is a keyword of Python: **{"lambda": 0.5}.
        **settings: float,
    ) -> Controller: ...
    def step(
        self,
        points: ArrayLike | None,
        time_s: float,
        visible: Sequence[bool] | None = None,
        exposed_s: float | None = None,
        wanted: ArrayLike | None = None,
        joints: ArrayLike | None = None,
    ) -> Step: ...
    def sent(self, twist: ArrayLike, time_s: float) -> None: ...
    def think(self) -> None: ...
    def reset(self) -> None: ...
    @property
    def foreseen(self) -> Foreseen: ...
    @property
    def strategy(self) -> str: ...

@final
class FreeCamera:
    def __new__(cls, scene: Scene, start: ArrayLike) -> FreeCamera: ...
    @property
    def points(self) -> _Array: ...
    @property
    def pose(self) -> _Array: ...
    def move(self, twist: ArrayLike, seconds: float | None = None) -> None: ...
    @property
    def referee(self) -> Literal["arrived", "violation"] | None: ...
    @property
    def violation(self) -> str | None: ...
    @property
    def least_clearance_px(self) -> float: ...
    @property
    def time_s(self) -> float: ...

@final
class Panda:
    def __new__(
        cls,
        scene: Scene,
        start: ArrayLike,
        *,
        noise: float = 0.0,
        drop: float = 0.0,
        depth_error: float = 0.0,
        motion: str | Sequence[str] = (),
        seed: int = 1,
        delay_ms: float = 110.0,
        jitter_ms: float = 0.0,
        focal_error: float = 0.0,
        hand_eye_cm: float = 0.0,
        hand_eye_deg: float = 0.0,
        unshaped: bool = False,
    ) -> Panda: ...
    @property
    def points(self) -> _Array | None: ...
    @property
    def visible(self) -> list[bool] | None: ...
    @property
    def exposed_s(self) -> float | None: ...
    @property
    def true_points(self) -> _Array: ...
    @property
    def pose(self) -> _Array: ...
    @property
    def twist(self) -> _Array: ...
    @property
    def joints(self) -> _Array: ...
    def move(self, twist: ArrayLike, elbow: float = 0.0) -> None: ...
    @property
    def referee(self) -> Literal["arrived", "violation", "reflex", "time_out"] | None: ...
    @property
    def violation(self) -> str | None: ...
    @property
    def least_clearance_px(self) -> float: ...
    @property
    def phase(
        self,
    ) -> Literal["waiting", "approach", "settling", "releasing", "retreating", "done"]: ...
    @property
    def report(self) -> PandaReport: ...
    @property
    def time_s(self) -> float: ...

@overload
def run(
    scene: Scene,
    starts: ArrayLike,
    strategies: Sequence[str | _Law],
    memory: Memory | None = None,
    *,
    robot: Literal["free"] = "free",
    progress: Callable[[int, int], object] | None = None,
    # Of camera and pattern.
    noise: float = 0.0,
    drop: float = 0.0,
    seed: int = 1,
    depth_error: float = 0.0,
    motion: str | Sequence[str] = (),
    rate: float | None = None,
    # Of the law.
    no_compensation: bool = False,
    no_drift: bool = False,
    at_samples_only: bool = False,
    brake_s: float = 0.0,
    model: Literal["target-depth", "area-depth", "pose"] = "pose",
    change_share: float = 0.03,
    filter_s: float = 0.15,
    filter_px: float = 1.0,
    step_s: float = 0.033,
    foresight_steps: int = 150,
    # Of the free camera.
    delay: int = 0,
    gain: float = 1.0,
    hide: float = 0.0,
    blackout_s: float = 0.0,
) -> list[Row]: ...
@overload
def run(
    scene: Scene,
    starts: ArrayLike,
    strategies: Sequence[str | _LateLaw],
    memory: Memory | None = None,
    *,
    robot: Literal["panda"],
    progress: Callable[[int, int], object] | None = None,
    # Of camera and pattern.
    noise: float = 0.0,
    drop: float = 0.0,
    seed: int = 1,
    depth_error: float = 0.0,
    motion: str | Sequence[str] = (),
    rate: float | None = None,
    # Of the law.
    no_compensation: bool = False,
    no_drift: bool = False,
    at_samples_only: bool = False,
    brake_s: float = 0.0,
    model: Literal["target-depth", "area-depth", "pose"] = "pose",
    change_share: float = 0.03,
    filter_s: float = 0.15,
    filter_px: float = 1.0,
    step_s: float = 0.033,
    foresight_steps: int = 150,
    # Of the emulated arm, and of its law.
    delay_ms: float = 110.0,
    jitter_ms: float = 0.0,
    focal_error: float = 0.0,
    hand_eye_cm: float = 0.0,
    hand_eye_deg: float = 0.0,
    unshaped: bool = False,
    trigger: float = 30.0,
    hysteresis: float = 2.0,
    margin: float = 0.0,
    ignore_marker_size: bool = False,
    ignore_arm: bool = False,
) -> list[PandaRow]: ...
def records(path: _Path, kind: str) -> list[str]: ...
