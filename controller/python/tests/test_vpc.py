"""What the module promises: `cargo test --test wheel -- --ignored` runs
`test_vpc.py TABLE VPC_MEMORY RECORDING`; pytest does after `cargo build --release`."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import vpc

ROOT = Path(__file__).resolve().parents[3]
PROGRAMS = [ROOT / "target/release/table", ROOT / "target/release/vpc-memory"]
SCENE = ROOT / "ipc/scene/scenes/paper-sim.toml"
STARTS = ROOT / "ipc/scene/scenes/paper-sim-starts.csv"
#: Of three cycles that commanded 0, 1 and 2 m/s along x.
RECORDING: list[str] = []
MEMORY = ROOT / "memory-blob/default/paper-sim.vpcmem"

scene = vpc.Scene.load(SCENE)
memory = vpc.Memory.load(MEMORY, scene)
starts = vpc.read_starts(STARTS)


def program(index: int, *arguments: object) -> str:
    words = [str(word) for word in (PROGRAMS[index], *arguments)]
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


def python(*arguments: object, place: str | Path = ROOT) -> str:
    words = [sys.executable, *map(str, arguments)]
    done = subprocess.run(words, cwd=place, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@contextlib.contextmanager
def raises(kind: type[BaseException], words: str) -> Iterator[None]:
    try:
        yield
    except kind as error:
        assert words in str(error), f"{words!r} is not in {str(error)!r}"
        return
    raise AssertionError(f"no {kind.__name__}: {words}")


def test_runs_are_those_of_the_table_to_the_bit() -> None:
    with tempfile.TemporaryDirectory() as place:
        lines = STARTS.read_text().splitlines(keepends=True)
        ten = Path(place, "ten.csv")
        ten.write_text("".join(lines[:11]))
        assert np.array_equal(vpc.read_starts(ten), starts[:10])
        for given, strategies in [
            (None, ["ibvs:3", "previous:3", "previous:30", "foresight:3"]),
            (memory, ["knn:3", "knn5:3", "gpr:3", "foresight:3"]),
        ]:
            out = Path(place, "out.json")
            words = ["--scene", SCENE, "--starts", ten, "--json", out, "--repeats", 1]
            words += ["--strategies", ",".join(strategies)]
            program(0, *words, *(["--memory", MEMORY] if given else []))
            wanted = json.loads(out.read_text())["runs"]
            rows = vpc.run(scene, starts[:10], strategies, given)
            assert len(rows) == len(wanted) == 40
            for row, run in zip(rows, wanted):
                mm, mrad = run["pose_error"] or (None, None)
                run |= {"error_mm": mm, "error_mrad": mrad}
                differ = {key for key, value in row.items() if run.get(key) != value}
                assert not differ, (row, run)


def test_a_loop_in_python_is_the_run() -> None:
    for strategy, given in [("foresight", memory), ("gpr", memory), ("previous", None)]:
        controller = vpc.Controller(scene, given, strategy)
        (row,) = vpc.run(scene, starts[3:4], [strategy], given)
        for _ in range(2):
            camera = vpc.FreeCamera(scene, starts[3])
            period, steps, iterations = 1 / scene.rate_hz, 0, 0
            while camera.referee is None:
                step = controller.step(camera.points, steps * period)
                controller.sent(step.twist, steps * period)
                controller.think()
                camera.move(step.twist)
                steps, iterations = steps + 1, iterations + step.iterations
            assert (camera.referee == "arrived") == row["success"]
            assert (steps, iterations) == (row["steps"], row["iterations"])
            assert controller.foreseen.path.shape[2] == 2 or strategy != "foresight"
            controller.reset()


def test_a_law_in_python_is_judged_as_ours() -> None:
    twists: list[np.ndarray] = []
    controller = vpc.Controller(scene, memory)

    class Ours:
        def reset(self) -> None:
            controller.reset()

        def __call__(self, points: np.ndarray, time_s: float) -> np.ndarray:
            twists.append(controller.step(points, time_s).twist)
            controller.think()
            return twists[-1]

    own, ours = vpc.run(scene, starts[5:6], [Ours(), "foresight"], memory)
    assert own["strategy"] == "Ours" and ours["strategy"] == "foresight:3"
    for key in ("success", "steps", "cost", "change", "error_mm", "least_between_px"):
        assert own[key] == ours[key], key
    fast = vpc.run(scene, starts[:1], [lambda points, time_s: [9.0] * 6])
    assert fast[0]["reason"] == "beyond_limits"
    with raises(ZeroDivisionError, "division"):
        vpc.run(scene, starts[:1], [lambda points, time_s: 1 / 0])
    with raises(ValueError, "twist: shape [2]; allowed: [6]"):
        vpc.run(scene, starts[:1], [lambda points, time_s: [1.0, 2.0]])


def test_another_command_than_the_step_is_taken_into_account() -> None:
    points = vpc.FreeCamera(scene, starts[0]).points
    after = []
    for share in (1.0, 0.5):
        controller = vpc.Controller(scene, memory, "previous")
        twist = share * controller.step(points, 0.0).twist
        controller.sent(twist, 0.0)
        camera = vpc.FreeCamera(scene, starts[0])
        camera.move(twist)
        after.append(controller.step(camera.points, 1 / scene.rate_hz))
    assert all(step.hold is None for step in after)
    assert not np.array_equal(after[0].twist, after[1].twist)


def test_a_wanted_twist_passes_to_the_bit_or_keeps_the_points_in_sight() -> None:
    controller = vpc.Controller(scene, strategy="follow")
    camera = vpc.FreeCamera(scene, starts[0])
    harmless, hostile = 1e-3 * np.array([1, -2, 3, 4, -5, 6]), np.array([0, 9, 0, 0, 0, 0.0])
    for wanted in [harmless] + 90 * [hostile] + 90 * [-hostile]:
        step = controller.step(camera.points, camera.time_s, wanted=wanted)
        assert step.state == "moving" and np.all(np.abs(step.twist) <= scene.velocity_limits)
        assert wanted is not harmless or np.array_equal(step.twist, wanted)
        camera.move(step.twist)
    assert camera.referee is None, camera.referee
    for _ in range(10):
        step = controller.step(camera.points, camera.time_s)
        assert step.hold == "no twist is wanted"
        camera.move(step.twist)
    assert not step.twist.any() and camera.referee is None
    with raises(ValueError, "twist = [NaN, 0.0, 0.0, 0.0, 0.0, 0.0]; allowed: six finite numbers"):
        controller.step(camera.points, camera.time_s, wanted=[np.nan, 0, 0, 0, 0, 0])


def test_a_guarded_camera_keeps_its_points_where_a_barrier_is_tried() -> None:
    said = python(ROOT / "tests/peers/guardian.py", "--starts", 2, "--cycles", 100)
    rows = {words[0]: words[1:] for words in map(str.split, said.splitlines()[1:])}
    deepest_px, changed = rows["follow"][:2]
    assert float(deepest_px) < 1 and changed == "0" and rows.keys() >= {"obeys", "CBF-QP"}, said


def test_starts_are_those_of_vpc_memory() -> None:
    with tempfile.TemporaryDirectory() as place:
        out = Path(place, "starts.csv")
        program(1, "starts", SCENE, "-o", out, "--count", 20, "--seed", 7)
        assert np.array_equal(vpc.read_starts(out), scene.starts(20, seed=7))


def test_a_memory_is_that_of_vpc_memory() -> None:
    told: list[tuple[int, int]] = []
    built = vpc.Memory.build(scene, 3, seed=5, progress=lambda *now: told.append(now))
    assert told[-1][0] == 3 and told[-1][1] >= 3
    with tempfile.TemporaryDirectory() as place:
        ours, theirs = Path(place, "ours"), Path(place, "theirs")
        built.save(ours)
        program(1, "build", SCENE, "-o", theirs, "--trajectories", 3, "--seed", 5)
        assert ours.read_bytes() == theirs.read_bytes()
        memory.save(ours)
        assert ours.read_bytes() == MEMORY.read_bytes()
        assert len(vpc.Memory.load(ours, scene)) == len(memory)


def test_a_memory_answers() -> None:
    points = vpc.FreeCamera(scene, starts[0]).points
    one, five = memory.neighbours(points), memory.neighbours(points, k=5)
    assert one.samples == five.samples[:1] and len(five.samples) == 5
    assert one.twist.shape == (6,) and one.way_point.shape == (4, 2)
    assert one.distance is not None and one.distance > 0 and one.correlation is None
    each = memory.gaussian_process(points)
    assert each.correlation is not None and 0 <= each.correlation <= 1
    assert each.twist_variance is None and each.samples == []
    known = vpc.Memory.build(scene, 2, variance=True).gaussian_process(points)
    assert known.twist_variance is not None and known.way_point_variance is not None
    assert np.all(known.twist_variance >= 0) and known.way_point_variance.shape == (4, 2)


def test_ctrl_c_ends_a_build() -> None:
    code = """if True:
        import vpc
        tell = lambda found, tried: print(found, tried, flush=True)
        vpc.Memory.build(vpc.Scene.built_in("paper-sim"), 100_000, progress=tell)
    """
    words = [sys.executable, "-c", code]
    build = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert build.stdout is not None
    assert build.stdout.readline()
    build.send_signal(signal.SIGINT)
    begin = time.monotonic()
    _, errors = build.communicate(timeout=120)
    print(f"    ended after {time.monotonic() - begin:.1f} s")
    assert "KeyboardInterrupt" in errors and build.returncode != 0, errors
    with raises(RuntimeError, "enough"):
        vpc.Memory.build(scene, 100_000, progress=stop)


def stop(found: int, tried: int) -> None:
    raise RuntimeError("enough")


def test_errors_say_what_is_allowed() -> None:
    with raises(FileNotFoundError, "/none/scene.toml: cannot read: No such file"):
        vpc.Scene.load("/none/scene.toml")
    with raises(ValueError, "mine.toml: camera.rate_hz = -1"):
        text = re.sub("rate_hz = .*", "rate_hz = -1", SCENE.read_text())
        vpc.Scene.parse(text, "mine.toml")
    with raises(ValueError, "scene `paper`; allowed: paper-sim, paper-robot, tags-robot"):
        vpc.Scene.built_in("paper")  # type: ignore[arg-type]
    with raises(FileNotFoundError, "cannot read the memory"):
        vpc.Memory.load("/none", scene)
    with raises(ValueError, "not an intact memory"):
        vpc.Memory.load(SCENE, scene)
    other = vpc.Scene.built_in("paper-robot")
    with raises(ValueError, "built for another task"):
        vpc.Memory.load(MEMORY, other)
    with raises(ValueError, "built for another task"):
        vpc.Controller(other, memory)
    with raises(ValueError, "trajectories = 0; allowed: 1 to 1e7"):
        vpc.Memory.build(scene, 0)
    with raises(ValueError, "np = 41; allowed: 1 to 40"):
        vpc.Controller(scene, memory, np=41)
    with raises(ValueError, "nc = 4; allowed: 1 to 4, at most np"):
        vpc.Controller(scene, memory, nc=4)
    with raises(ValueError, "brake_s = 11; allowed: 0 to 10 s"):
        vpc.Controller(scene, memory, brake_s=11)
    with raises(ValueError, "unknown field `npp`"):
        vpc.Controller(scene, memory, npp=4)
    with raises(ValueError, "strategy = "):
        vpc.Controller(scene, memory, "magic")
    with raises(ValueError, "memory is missing"):
        vpc.Controller(scene, strategy="knn")
    with raises(ValueError, "allowed: previous, knn"):
        vpc.run(scene, starts[:1], ["magic"])
    with raises(ValueError, "neighbours: 65; allowed: 1 to 64"):
        memory.neighbours(scene.goal, 65)
    with raises(ValueError, "points: shape [3, 2]; allowed: [4, 2]"):
        memory.neighbours(scene.goal[:3])
    controller = vpc.Controller(scene, memory)
    with raises(ValueError, "points: shape [4]; allowed: [4, 2]"):
        controller.step([1, 2, 3, 4], 0.0)
    with raises(ValueError, "time_s = -1; allowed: 0 to"):
        controller.step(scene.goal, -1)
    with raises(ValueError, "visible: 2 flags; allowed: 4"):
        controller.step(scene.goal, 0.0, visible=[True, False])
    with raises(ValueError, "start = [0.0, 0.0, -1.0"):
        vpc.FreeCamera(scene, [0, 0, -1, 0, 0, 0])
    with raises(ValueError, "starts: shape [6]; allowed: [any number, 6]"):
        vpc.run(scene, starts[0], ["ibvs"])
    with raises(ValueError, "not a recording"):
        vpc.records(SCENE)


def test_points_that_cannot_be_trusted_hold() -> None:
    points = vpc.FreeCamera(scene, starts[0]).points
    controller = vpc.Controller(scene, memory)
    step = controller.step(np.full((4, 2), np.nan), 0.0)
    assert step.hold and not step.twist.any(), step
    controller.reset()
    step = controller.step(points[[1, 0, 2, 3]], 0.0)
    assert (step.state, step.hold) == ("holding", "points mixed up"), step
    controller.reset()
    assert controller.step(points, 0.0).hold is None
    assert controller.step(None, 0.033).hold is None
    seen = controller.step(points, 5.0)
    assert seen.hold, seen


def test_threads_go_on_and_share() -> None:
    done = threading.Event()
    count = 0

    def work() -> None:
        vpc.run(scene, starts[:3], ["foresight"], memory)
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    while not done.wait(0.001):
        count += 1
    thread.join()
    assert count > 50, count
    controller = vpc.Controller(scene, memory)
    points = vpc.FreeCamera(scene, starts[0]).points
    failures: list[BaseException] = []

    def steps() -> None:
        try:
            for _ in range(50):
                controller.step(points, time.monotonic() - begin)
                controller.think()
                assert controller.foreseen.outcome in ("arrives", "nears", "unknown")
        except BaseException as error:
            failures.append(error)

    begin = time.monotonic()
    threads = [threading.Thread(target=steps) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures, failures


def test_arrays_of_any_layout_are_taken() -> None:
    points = vpc.FreeCamera(scene, starts[0]).points
    wanted = memory.neighbours(points).twist
    for given in (points.tolist(), np.asfortranarray(points), points[::-1][::-1]):
        assert np.array_equal(memory.neighbours(given).twist, wanted)
    assert memory.neighbours(points.astype(np.float32)).twist.dtype == np.float64


def test_the_scene_tells_what_it_has() -> None:
    assert scene.size == (1024.0, 1024.0) and scene.pattern.shape == (4, 3)
    assert scene.goal.shape == (4, 2) and abs(scene.goal[2] - 712).max() < 1e-9
    assert scene.velocity_limits.shape == (6,) and np.isinf(scene.acceleration_limits).all()
    camera = vpc.FreeCamera(scene, scene.goal_pose)
    assert camera.referee == "arrived" and np.allclose(camera.points, scene.goal)
    camera.move([0.5, 0, 0, 0, 0, 0], seconds=0.9)
    assert camera.referee == "violation" and camera.violation is not None
    assert len(scene.occlusions) == 4 and camera.least_clearance_px < 0


def test_a_recording_is_read() -> None:
    for path in RECORDING:
        cycles = list(vpc.records(path))
        assert [cycle["twist"][0] for cycle in cycles] == [0, 1, 2]
        assert list(vpc.records(path, "robot")) == []
        assert [wish["twist"][0] for wish in vpc.records(path, "desired")] == [3]
    with raises(ValueError, "kind `laps`; allowed: cycles, desired, features"):
        vpc.records(*RECORDING or [SCENE], "laps")


def test_rows_become_a_table_of_pandas() -> None:
    try:
        import pandas
    except ImportError:
        return
    table = pandas.DataFrame(vpc.run(scene, starts[:2], ["ibvs", "previous"]))
    assert list(table.groupby("strategy")["success"].count()) == [2, 2]
    assert table["cost"].dtype == np.float64


def test_the_version_is_the_workspaces() -> None:
    with (ROOT / "Cargo.toml").open("rb") as file:
        assert vpc.__version__ == tomllib.load(file)["workspace"]["package"]["version"]


def test_the_readme_and_the_examples_run_and_type_check() -> None:
    text = (ROOT / "controller/python/README.md").read_text()
    (snippet,) = re.findall(r"```python\n(.*?)```", text, re.S)
    examples = [ROOT / "controller/python/examples" / name for name in ("your_law.py", "paper.py")]
    with tempfile.TemporaryDirectory() as place:
        readme = Path(place, "readme.py")
        readme.write_text(snippet)
        assert python(readme).startswith("arrived")
        # Both leave their caches there.
        python("-m", "mypy", "--strict", readme, *examples, place=place)
        python("-m", "mypy.stubtest", "--ignore-missing-stub", "vpc", place=place)
    assert "foresight:3     10 of 10" in (said := python(examples[0])), said
    assert re.search(r"foresight +\d+ steps: arrived", said := python(examples[1])), said


if __name__ == "__main__":
    PROGRAMS[:] = map(Path, sys.argv[1:3])
    RECORDING[:] = sys.argv[3:]
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    for name, test in [*globals().items()]:
        if name.startswith("test_"):
            begin = time.monotonic()
            test()
            print(f"{name}: {time.monotonic() - begin:.1f} s", flush=True)
