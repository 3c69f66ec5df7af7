import math
import os
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import pytest

import telepulse
from protocol.config.scene_file import find_scene
from protocol.errors import SceneError, SweepError
from telepulse import parallel as sweep_module
from telepulse.parallel import THREADS, SweepResults, in_one_thread, sweep
from tests.support.nodes import free_address, process, run_python

LONG_S = 60
play_little = partial(telepulse.simulate, "radial", 2.0, link="delay=20ms,jitter=3ms,loss=5%")


def scheduler_at(address: str) -> tuple[str, ...]:
    parts = urlsplit(address)
    return ("scheduler", "--host", str(parts.hostname), "--port", str(parts.port), "--no-dashboard")


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of a Dask scheduler in a process of its own, with two workers in theirs."""
    from distributed import Client

    address = free_address()
    worker = ("worker", address, "--no-nanny", "--nthreads", "1", "--no-dashboard")
    with (
        process("dask", *scheduler_at(address)),
        process("dask", *worker),
        process("dask", *worker),
    ):
        with Client(address, timeout=LONG_S, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=LONG_S)
        yield address


def test_results_come_in_the_order_of_the_cases_from_workers_of_one_thread() -> None:
    # The first case takes far longer than the second.
    assert sweep(math.factorial, [60_000, 3, 2]) == [math.factorial(60_000), 6, 2]
    assert sweep(math.sqrt, (number for number in (4, 9))) == [2, 3]
    assert sweep(math.sqrt, []) == []
    assert sweep(os.getenv, [THREADS] * 3) == ["1"] * 3


def play_over(link: dict[str, float]) -> telepulse.Run:
    display = {"predictor": "linear", "compensation": "60 ms"}
    delay = f"delay={link['one_way_delay_ms']}ms"
    return telepulse.simulate("radial", 3, link=delay, display=display)


def test_a_sweep_is_a_table_of_its_cases_and_figures() -> None:
    cases = [{"one_way_delay_ms": delay_ms} for delay_ms in (10.0, 30.0)]
    runs = sweep(play_over, cases)
    assert [type(run) for run in runs] == [telepulse.Run] * 2
    frame = runs.to_dataframe()
    assert list(frame["one_way_delay_ms"]) == [10, 30]
    for run, row in zip(runs, frame.to_dict("records"), strict=True):
        errors = run.summary.force_rmse_n
        found = row["force_rmse_n.aligned"], row["force_rmse_n.in_phase"]
        assert found == (errors.aligned, errors.in_phase)
        assert row["one_way_delay_ms.p50"] == pytest.approx(row["one_way_delay_ms"], abs=1)
    assert frame["samples.lost"].sum() == 0
    assert sweep(math.sqrt, [4, 9]).columns() == {"case": [4, 9], "result": [2, 3]}
    beats = SweepResults([{"interval_s": 1}, "scene"], [{"interval_s": 2, "height_n": 3}, None])
    assert beats.columns() == {
        "interval_s": [1, None],
        "result.interval_s": [2, None],
        "height_n": [3, None],
        "case": [None, "scene"],
        "result": [None, None],
    }


def test_a_function_runs_elsewhere_with_one_thread_and_the_environment_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for before in (None, "3"):
        monkeypatch.delenv(THREADS, raising=False)
        if before is not None:
            monkeypatch.setenv(THREADS, before)
        assert in_one_thread(os.getenv, THREADS) == "1"
        assert os.environ.get(THREADS) == before


def test_an_error_of_one_thread_is_raised_here() -> None:
    with pytest.raises(SceneError, match="no such scene"):
        in_one_thread(find_scene, "nowhere")


def test_all_cores_and_a_cluster_find_the_results_of_one_process(cluster: str) -> None:
    seeds = (1, 2, 3)
    alone = [play_little(seed).summary.force_rmse_n for seed in seeds]
    assert len({errors.in_phase for errors in alone}) == len(seeds)
    for scheduler in (None, cluster):
        found = sweep(play_little, seeds, scheduler)
        assert [run.summary.force_rmse_n for run in found] == alone


def test_a_case_that_fails_is_named(cluster: str) -> None:
    with pytest.raises(SweepError, match=r"^-1: ValueError: math domain error$"):
        sweep(math.sqrt, [4, -1, 9], cluster)
    with pytest.raises(SweepError, match=r"^-3: ArgumentError: "):
        sweep(play_little, [1, -3])


def test_a_worker_that_dies_is_reported() -> None:
    with pytest.raises(SweepError, match=r"^3: a worker process died: for lack of memory, or"):
        sweep(os._exit, [3])


def test_a_program_without_a_guard_is_told_of_it(tmp_path: Path) -> None:
    call = "telepulse.sweep(len, ['abc' * 100] * 2)"
    program = tmp_path / "program.py"
    program.write_text(f"import telepulse\n{call}\n", encoding="utf-8")
    failed = run_python(str(program), cwd=tmp_path).stderr.splitlines()[-1]
    assert failed.startswith("protocol.errors.SweepError: abcabc")
    assert failed.endswith('calls sweep outside of `if __name__ == "__main__":`')
    assert len(failed) < 300
    guarded = f"import telepulse\nif __name__ == '__main__':\n    print({call})\n"
    program.write_text(guarded, encoding="utf-8")
    assert run_python(str(program), cwd=tmp_path).stdout == "[300, 300]\n"


def test_no_scheduler_is_one_line(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    monkeypatch.setattr(sweep_module, "CONNECT_S", 0.3)
    with pytest.raises(SweepError, match=f"^{address}: no Dask scheduler answers: .*connect") as e:
        sweep(math.sqrt, [4], address)
    assert "\n" not in str(e.value)


def test_a_scheduler_without_workers_is_reported(
    monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    with process("dask", *scheduler_at(address)) as scheduler:
        while "Scheduler at" not in scheduler.read_line(LONG_S, from_stderr=True):
            pass
        monkeypatch.setattr(sweep_module, "CONNECT_S", 3)
        with pytest.raises(SweepError, match="no worker has joined; start one: dask worker"):
            sweep(math.sqrt, [4], address)


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SweepError, match=r"pip install 'telepulse\[cluster\]'"):
        sweep(math.sqrt, [4], "tcp://127.0.0.1:8786")
