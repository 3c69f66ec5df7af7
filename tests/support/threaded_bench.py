"""A bench in virtual time with the product's drive, sensor, `Hardware` and `Display`, unchanged.

The lines to an emulated drive and its film, the network and the process are virtual: all threads
of the process, or single ones, can be stalled.
"""

from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field

from display_node.display import Display
from display_node.hardware import build_display_drive
from display_node.plant.contact import ContactLaw
from display_node.plant.scene import StepperScene
from display_node.scene import DisplayScene
from protocol.host.realtime import Pacer
from pulse_drives import Drive
from pulse_drives.scene import DriveScene
from pulse_drives.stepdir.scene import StepdirScene
from pulse_sensors.drive_film import DriveFilmDecoder, DriveFilmScene
from pulse_sensors.sensor import Sensor
from pulse_sensors.serial_port import SerialScene
from telepulse.emulators.drive_run import EmulatedFilm
from telepulse.emulators.motor import MotorState
from tests.support.fault_injection import FaultyBoard, FaultyMotor
from tests.support.sender import MS, Sender
from tests.support.virtual_lines import PORT_BYTES, Pipe, virtual_line
from tests.support.virtual_time import VirtualThread, VirtualTime

# The modules besides the drive's that wait or read the clock.
VIRTUAL = ("display_node.hardware", "pulse_sensors.sensor")
BATCH = 5
NETWORK_NS = 2 * MS


class FilmPort:
    """The film's serial port, as `Sensor` reads it. silent: the board sends nothing."""

    name = "film"

    def __init__(self, world: VirtualTime) -> None:
        self._pipe = Pipe(world)
        self.silent = False

    def open(self) -> None:
        pass

    def write(self, data: bytes) -> None:
        if not self.silent:
            self._pipe.write(data)

    def read(self) -> bytes:
        return self._pipe.read(PORT_BYTES, 0.1)

    def close(self) -> None:
        pass


@dataclass
class ThreadedBench:
    """A bench on which a pulse is felt after `start`.

    Conditions are changed between two runs: `sending`, `film.silent`, `motor.injector`,
    `world.stall`.

    scene: with a drive. force_n: the pulse, by ms. with_film: the scene's film is read; otherwise
    the force is estimated from the drive's position. watch: called with the motor's state every
    ms; by default `moments` collects them. finger: its stiffness, as a factor of the scene's. law:
    the contact with the tip, if it is not a finger's. on_tick: called with the time and the target
    of every tick. late_ns: by how much a tick of a time in ns is late. fault_ns: time of the
    display's first fault.
    """

    scene: DisplayScene
    force_n: Callable[[int], float]
    with_film: bool = True
    watch: Callable[[MotorState], None] | None = None
    finger: float = 1.0
    law: ContactLaw | None = None
    sending: bool = True
    world: VirtualTime = field(default_factory=VirtualTime)
    loop: VirtualThread | None = None
    on_tick: Callable[[int, float], object] = lambda *_: None
    late_ns: Callable[[int], int] = lambda _: 0
    fault_ns: int | None = None

    def __post_init__(self) -> None:
        if not self.with_film:
            self.scene = self.scene.model_copy(update={"feedback": None})
        assert isinstance(self.scene.actuator, StepperScene)
        assert self.scene.drive is not None
        self.drive_scene: DriveScene = self.scene.drive
        world, actuator = self.world, self.scene.actuator
        stiffness = self.finger * actuator.fingertip_n_per_m
        finger = actuator.model_copy(update={"fingertip_n_per_m": stiffness})
        law = self.law or finger.contact(self.scene.layer.layer())
        self.motor: FaultyMotor | FaultyBoard
        if isinstance(self.drive_scene, StepdirScene):
            film, noise_n = self.drive_film, self.scene.film.noise_n
            self.motor = FaultyBoard(self.drive_scene, finger, law, film, world.now_ns, noise_n)
        else:
            self.motor = FaultyMotor(actuator, law, self.drive_scene.touch_m, world.now_ns)
        self.moments: list[MotorState] = []
        self.motor.trace = self.watch or self.moments.append
        self.film = FilmPort(world)
        self._board = EmulatedFilm(self.motor, self.film)
        self.sender, self._streamed_ms = Sender(), 0
        self._frames: deque[tuple[int, bytes]] = deque()
        self._answers: deque[tuple[int, bytes]] = deque()
        self._stopping = False
        self._patches = ExitStack()

    def __enter__(self) -> "ThreadedBench":
        world = self.world
        self._patches.enter_context(virtual_line(world, self.drive_scene, self.motor, VIRTUAL))
        world.every(MS, self._poll_motor)
        world.every(BATCH * MS, self._send_frame)
        return self

    def __exit__(self, *_: object) -> None:
        self._patches.close()

    def start(self, loop_after_ms: int = 0) -> None:
        """Home the drive, move it to first touch and begin the loop."""
        self.call(self.connect)
        self.run(loop_after_ms)
        self._stopping = False
        self.loop = self.world.thread(self._loop, name="loop")

    def stop(self) -> None:
        self._stopping = True
        if self.loop is not None:
            self.loop.join()
        self.call(self.hardware.close)

    def run(self, ms: float) -> None:
        self.world.run(self.world.now_ns + round(ms * MS))

    def stall(self, ms: int, loop_first: bool = False) -> None:
        """Stop the display's process for some time, as by SIGSTOP; which thread wakes first."""
        threads = sorted(self.threads, key=lambda thread: (thread.name == "loop") != loop_first)
        self.world.stall(threads, self.world.now_ns + ms * MS)
        self.run(ms)

    @property
    def drive_film(self) -> DriveFilmScene | None:
        """The film that the drive's board reads, if it reads one."""
        film = self.scene.feedback
        return film if isinstance(film, DriveFilmScene) else None

    @property
    def faults(self) -> list[str]:
        return list(map(str, self.display.fade.faults))

    @property
    def threads(self) -> list[VirtualThread]:
        return list(self.world.threads)

    def call(self, function: Callable[[], object]) -> None:
        raised: list[Exception] = []

        def run() -> None:
            try:
                function()
            except Exception as error:
                raised.append(error)

        self.world.thread(run, name="main").join()
        if raised:
            raise raised[0]

    def connect(self) -> None:
        """Start the bench as `display_node.node.connected` does, the film on a virtual port."""
        scene, actuator = self.scene, self.scene.actuator
        assert scene.drive is not None
        force_limit_n = scene.safety.force_limit_n
        self.drive: Drive = build_display_drive(
            scene.drive, actuator, scene.layer.layer(), force_limit_n
        )
        sensor, film, clock = None, scene.feedback, self.world.perf_counter_ns
        if isinstance(film, SerialScene):
            sensor = Sensor(self.film, film.decoder(), film, clock=clock)
        elif isinstance(film, DriveFilmScene):
            port = self.drive.film_port(*film.counts_within(scene.safety.overforce_n))
            sensor = Sensor(port, DriveFilmDecoder(film.period_ns), film, clock=clock)
        self.hardware = scene.hardware(self.drive, sensor)
        try:
            self.hardware.start()
        except BaseException:
            self.hardware.close()
            raise
        self.display = Display(scene, "virtual")
        self.display.use(self.hardware)

    def _poll_motor(self) -> None:
        self.motor.advance(self.world.now_ns)
        if self.with_film and self.drive_film is None:
            self._board.deliver()
        elif self.drive_film is None:
            self.motor.forces_n.clear()

    def _send_frame(self) -> None:
        now_ns = self.world.now_ns
        if self.sending:
            forces_n = [self.force_n(self._streamed_ms + number) for number in range(BATCH)]
            frame = self.sender.frame_of(now_ns, forces_n)
            self._frames.append((now_ns + NETWORK_NS, frame))
        # The pulse continues while nothing is sent.
        self._streamed_ms += BATCH

    def _loop(self) -> None:
        """Run the loop of `display_node.node.DisplayNode.run`, without sockets."""
        world = self.world
        pacer = Pacer(self.scene.tick_ns, world.perf_counter_ns())
        while not self._stopping:
            now_ns = world.perf_counter_ns()
            tick = pacer.begin(now_ns)
            if tick is None:
                world.sleep((pacer.due_ns - now_ns) * 1e-9)
                continue
            if late_ns := self.late_ns(now_ns):
                world.sleep(late_ns * 1e-9)
            self._receive(now_ns)
            self._tick(tick.due_ns, tick.elapsed_ticks)

    def _receive(self, now_ns: int) -> None:
        """Receive messages when they arrive, or when a stalled loop wakes."""
        display, woke_ns = self.display, self.loop.resumes_ns if self.loop is not None else 0
        while self._frames and self._frames[0][0] <= now_ns:
            arrived_ns, data = self._frames.popleft()
            display.on_frame(data, max(arrived_ns, woke_ns))
        while self._answers and self._answers[0][0] <= now_ns:
            arrived_ns, data = self._answers.popleft()
            display.on_control(data, max(arrived_ns, woke_ns))

    def _tick(self, now_ns: int, elapsed_ticks: int) -> None:
        felt = self.display.tick(now_ns, elapsed_ticks)
        self.on_tick(now_ns, felt.target_n)
        while self.display.work():
            pass
        if self.faults and self.fault_ns is None:
            self.fault_ns = self.world.now_ns
        for request in self.display.requests(self.world.perf_counter_ns()):
            sent_ns = self.world.now_ns
            answer = self.sender.answer(request, sent_ns + NETWORK_NS)
            if answer is not None and self.sending:
                self._answers.append((sent_ns + 2 * NETWORK_NS, answer))
