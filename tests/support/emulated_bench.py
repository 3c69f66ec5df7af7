"""The emulated bench as a user starts it: board, drive, sensing node and display node.

Each is a process of its own. The drive's emulator records its motor.
"""

import json
import os
import re
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit
import zmq
from numpy.typing import NDArray

from protocol.config.scene_file import find_scene, load_document
from protocol.host.child_process import ChildProcess
from protocol.wire.telemetry import Status
from telepulse.emulators.sensor_board import COUNTS
from telepulse.processes import free_addresses
from tests.support.live_display import await_status, subscribe
from tests.support.nodes import process
from tests.support.waiting import until

KINDS = ("tmcl", "cia402")
# Shipped scenes that are not named after their kind of drive.
SCENES = {"stepdir": "class_bench"}
PORTS = "/tmp/telepulse-"
CHANNEL = "239.74.163.2"
STATE_WITHIN_S = 40.0
ENDS_WITHIN_S = 20.0
# The longest that a scene may allow.
FEEDBACK_WITHIN = "80 ms"
NICE = -15
# The end of the motor's trace, some 100 ms.
RESTED_BYTES = 5_000


class MotorTrace(NamedTuple):
    """The record of the emulated motor, one value per millisecond.

    trouble_ns: when a fault of it or of its film began, on the monotonic clock; None without one.
    """

    time_ns: NDArray[np.int64]
    speed_m_per_s: NDArray[np.float64]
    force_n: NDArray[np.float64]
    trouble_ns: int | None


class BenchFailedError(RuntimeError):
    """A process of the bench did not start, or did not reach a state."""


def bench_scene_text(folder: Path, kind: str, watchdog_ms: int, name: str = "") -> str:
    """Return the scene of an emulated bench with its ports in a folder.

    name: of the shipped scene; by default, that of the kind of drive. watchdog_ms: of the drive,
    for a busy machine; 0: the scene's.
    """
    tables = load_document(find_scene(name or SCENES.get(kind, f"{kind}_bench")))
    if kind == "stepdir":
        tables["sensing"]["source"].update(COUNTS)
    text = tomlkit.dumps(tables).replace(PORTS, f"{folder}/")
    if watchdog_ms:
        keys = f'watchdog = "{watchdog_ms} ms"\n'
        if kind == "tmcl":
            keys += f'reply_timeout = "{watchdog_ms // 4} ms"\n'
        text = text.replace("[display.drive]\n", f"[display.drive]\n{keys}")
        film = f'feedback_within = "{FEEDBACK_WITHIN}"\n'
        text = text.replace("[display.safety]\n", f"[display.safety]\n{film}")
    return text


@dataclass
class EmulatedBench:
    """Four processes and their files.

    source: the scene that the board plays. drive_options: further options of the drive's emulator.
    watchdog_ms: see `bench_scene_text`. output: the descriptor that the display prints to; None:
    the log, and errors only. name: of the shipped scene, see `bench_scene_text`.
    """

    folder: Path
    kind: str
    source: str = "real_bench"
    drive_options: tuple[str, ...] = ()
    watchdog_ms: int = 0
    output: int | None = None
    name: str = ""
    # Of the display, see `altered_node`.
    alteration: str = ""
    processes: dict[str, ChildProcess] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.address, self.telemetry = free_addresses(2)
        self.scene = self.folder / "scene.toml"
        # A channel of its own, so that it does not interfere with another bench.
        last = 10 + int(re.findall(r"\d+$", self.address)[0]) % 200
        text = bench_scene_text(self.folder, self.kind, self.watchdog_ms, self.name)
        self.scene.write_text(text.replace(CHANNEL, f"239.74.163.{last}"), encoding="utf-8")

    def start_board(self) -> None:
        words = ("emulate", "sensor", self.source, "--link", self.folder / "board")
        counts = ("--samples", "int16") if self.kind == "stepdir" else ()
        self.start("board", "telepulse", *words, "--delivery-ms", "4", *counts)

    def start_drive(self, contactor: str = "") -> None:
        """Start the drive's emulator; contactor: of which, its name ends those of the files."""
        end = f"-{contactor}" if contactor else ""
        serial = ("--link", self.folder / f"drive{end}") if self.kind != "cia402" else ()
        film = ("--film-link", self.folder / f"film{end}") if self.kind != "stepdir" else ()
        trace = ("--trace", self.folder / f"motor{end}.csv")
        which = ("--contactor", contactor) if contactor else ()
        lines = (*serial, *film, *trace)
        words = ("emulate", self.kind, self.scene, *which, *lines, *self.drive_options)
        self.start(f"drive{end}", "telepulse", *words)

    @property
    def film(self) -> Path:
        """The port on which the film comes."""
        return self.folder / ("drive" if self.kind == "stepdir" else "film")

    def start_sensing(self) -> None:
        self.start("sensing", "sensing_node.cli", self.scene, "--bind", self.address)

    def start_display(self) -> None:
        words = (self.scene, "--connect", self.address, "--telemetry", self.telemetry)
        json_file = self.folder / "display.json"
        volume = "--quiet" if self.output is None else "--no-screen"
        altered = ("tests.support.altered_node", self.alteration) if self.alteration else ()
        module, *more = (*altered, "display_node.cli", *words, volume, "--json", json_file)
        self.start("display", str(module), *more)

    def await_state(
        self, wanted: str, within_s: float = STATE_WITHIN_S, played: int = 0
    ) -> dict[str, Any]:
        """Wait for a state of the display ("playing", "fault") and return its summary then.

        played: number of samples whose instant it has played by then, in total.
        """

        def reached(status: Status) -> bool:
            return status.state == "fault" or (
                status.state == wanted and status.summary["samples"]["sent"] >= played
            )

        with zmq.Context() as context, subscribe(context, self.telemetry) as telemetry:
            try:
                status = await_status(telemetry, reached, within_s)
            except TimeoutError as error:
                raise BenchFailedError(f"{error}\n{self.log()}") from None
        if status.state != wanted:
            raise BenchFailedError(f"the display: {status.summary['faults']}\n{self.log()}")
        return status.summary

    def await_rest(self, withdrawn: bool = False) -> None:
        """Wait until the motor has rested for 100 ms; withdrawn: and its film is free of force."""
        began_ns = time.perf_counter_ns()

        def rests() -> bool:
            text = (self.folder / "motor.csv").read_text("utf-8")
            _, *lines, _ = text[-RESTED_BYTES:].splitlines()
            times_ns, _, speeds, forces_n, _ = zip(*(x.split(",") for x in lines), strict=True)
            values = (*speeds, *(forces_n if withdrawn else ()))
            return int(times_ns[0]) > began_ns and not any(map(float, values))

        until(rests)

    def end(self) -> dict[str, Any]:
        """Stop all processes; return the display's summary, empty if it was killed."""
        order = ("display", "sensing")
        for name in (*order, *(other for other in self.processes if other not in order)):
            process = self.processes.get(name)
            if process is not None and process.poll() is None:
                process.terminate()
                process.wait(ENDS_WITHIN_S)
        path = self.folder / "display.json"
        summary: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.exists() else {}
        return summary

    def motor(self, contactor: str = "") -> MotorTrace:
        path = self.folder / (f"motor-{contactor}.csv" if contactor else "motor.csv")
        rows = np.genfromtxt(
            # The last line may not be complete yet.
            path.read_text("utf-8").splitlines()[:-1],
            delimiter=",",
            names=True,
            dtype=None,
            encoding="utf-8",
            # The text column is longer in later rows than in the first ones.
            converters={4: lambda text: bool(text)},
        )
        wrong = np.flatnonzero(rows["trouble"])
        trouble_ns = int(rows["time_ns"][wrong[0]]) if len(wrong) else None
        return MotorTrace(rows["time_ns"], rows["speed_m_per_s"], rows["force_n"], trouble_ns)

    def log(self) -> str:
        return (self.folder / "log").read_text("utf-8")

    def start(self, name: str, module: str, *words: object) -> None:
        """Start a process, in place of the last one of its name."""
        if name in self.processes:
            self.processes[name].wait()
        with (self.folder / "log").open("ab") as log:
            output = log if self.output is None or name != "display" else self.output
            arguments = map(str, words)
            process = ChildProcess(name, "-m", module, *arguments, stdout=output, stderr=output)
            self.processes[name] = process
        # Other load on this machine must not look like a fault, where the priority is permitted.
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, process.pid, NICE)

    def stall(self, name: str, seconds: float) -> ChildProcess:
        """Stop a process for some time, and return it."""
        process = self.processes[name]
        process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        process.send_signal(signal.SIGCONT)
        return process

    def kill(self) -> None:
        for child in self.processes.values():
            if child.poll() is None:
                child.kill()
            child.wait()


@contextmanager
def emulated_tmcl(scene: Path, *options: str) -> Iterator[ChildProcess]:
    """Run a module whose lines are `drive` and `film` in the scene's folder, until the end."""
    drive, film = scene.parent / "drive", scene.parent / "film"
    links = ("--link", str(drive), "--film-link", str(film))
    with process("telepulse", "emulate", "tmcl", str(scene), *links, *options) as child:
        assert child.read_line(STATE_WITHIN_S) == f"TMCL module on {drive}; film on {film}"
        yield child
        if child.poll() is None:
            child.terminate()
            child.wait(ENDS_WITHIN_S)


@contextmanager
def playing(
    folder: Path,
    kind: str,
    source: str = "real_bench",
    *drive_options: str,
    watchdog_ms: int = 0,
    output: int | None = None,
    alteration: str = "",
) -> Iterator[EmulatedBench]:
    """Provide a bench on which the pulse is felt. Raises BenchFailedError."""
    with ExitStack() as leaving:
        bench = EmulatedBench(folder, kind, source, drive_options, watchdog_ms, output)
        bench.alteration = alteration
        leaving.callback(bench.kill)
        bench.start_board()
        bench.start_drive()
        deadline_s = time.monotonic() + STATE_WITHIN_S
        while not ((folder / "board").exists() and bench.film.exists()):
            if time.monotonic() > deadline_s:
                raise BenchFailedError(f"board and drive do not start\n{bench.log()}")
            time.sleep(0.05)
        bench.start_sensing()
        bench.start_display()
        bench.await_state("playing")
        yield bench
