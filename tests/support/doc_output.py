"""The commands on the pages, with how each is run here, or why it is not."""

import json
import shutil
from pathlib import Path

from tests.support.doc_pages import PYTHON, blocks
from tests.support.doc_sessions import Do, Step, Stop
from tests.support.nodes import run_python
from tests.support.signal_files import pulse_and_ecg, wfdb_record

SENSE = "sensing-node scenes/radial.toml"
PLAY = "display-node scenes/radial.toml"
SERVED = "--bind tcp://127.0.0.1:5555"
FROM_THERE = "--connect tcp://127.0.0.1:5555"
STREAMING = "streaming 'radial pulse'"
PROTECTED = "sensing-node scenes/radial.toml --bind tcp://*:5555 --key keys/wrist.key"
BEHIND = "tests/system/links/test_behind_routers.py"
COMPOSE = "needs an engine, and a registry for the base image; tests/system/containers"
PROMETHEUS = "tests/system/metrics/test_prometheus.py"
SSH = "ssh -o ExitOnForwardFailure=yes -o ServerAliveInterval=5"
RELAY = (
    "telepulse relay --connect tcp://SENSING:5555 --bind tcp://*:5655 --key keys/relay.key"
    " --peer keys/wrist.pub"
)
AT_THE_FINGER = (
    "display-node scenes/radial.toml --connect tcp://HOST:5555 --key keys/finger.key"
    " --peer wrist.pub"
)
LINK = "delay=40ms,jitter=10ms,loss=1%"


def carry(what: str, where: str) -> Do:
    """Copy a file from one machine's folder to another's."""
    return lambda folder: shutil.copy(folder / what, folder / where) and None


def felt(where: str) -> Do:
    """Check in a summary that a pulse was played."""

    def look(folder: Path) -> None:
        samples = json.loads((folder / where).read_text(encoding="utf-8"))["samples"]
        assert samples["played"] + samples["predicted"] > 0

    return look


def loads(folder: Path) -> None:
    """Write reference loads and a film's readings."""
    text = "load (g), reading_mV\n0, 0.1\n50, 22\n100, 43.5\n150, 65\n200, 86.4\n"
    (folder / "loads.csv").write_text(text, encoding="utf-8")


def snippets_of(page: str) -> Do:
    """Run a page's Python in the folder of the commands' output."""

    def run(folder: Path) -> None:
        codes = [block.text for block in blocks() if (block.page, block.language) == (page, PYTHON)]
        assert codes
        for code in codes:
            ended = run_python("-c", code, cwd=folder)
            assert ended.returncode == 0, ended.stderr

    return run


def on_air(command: str, more: str = "", at: str = ".") -> list[Step | Stop | Do]:
    """Run a display until it plays, and end it by Ctrl-C."""
    return [Step(command, more=more, at=at, shows="playing"), Stop(command)]


SESSIONS: dict[str, list[Step | Stop | Do]] = {
    "two machines": [
        Step("telepulse keys new wrist", at="wrist"),
        Step("telepulse keys new finger", at="finger"),
        carry("finger/keys/finger.pub", "wrist/finger.pub"),
        carry("wrist/keys/wrist.pub", "finger/wrist.pub"),
        Step("telepulse keys allow finger.pub", at="wrist", says="keys/allowed allows finger"),
        Step(PROTECTED, at="wrist", shows=STREAMING),
        *on_air(AT_THE_FINGER, at="finger"),
        Step("telepulse keys new relay", at="relay"),
        carry("wrist/keys/wrist.pub", "relay/keys/wrist.pub"),
        carry("finger/keys/finger.pub", "relay/finger.pub"),
        carry("relay/keys/relay.pub", "wrist/relay.pub"),
        carry("relay/keys/relay.pub", "finger/relay.pub"),
        Step("telepulse keys allow relay.pub", at="wrist"),
        Step("telepulse keys allow finger.pub", at="relay"),
        Step(RELAY, at="relay", shows="tcp://"),
        *on_air(
            PLAY,
            more="--connect tcp://127.0.0.1:5655 --key keys/finger.key --peer relay.pub",
            at="finger",
        ),
    ],
    "tutorial": [
        Step("make demo", more="--seconds 2", says="page: http://127.0.0.1:"),
        Step(f"""make demo ARGS="--link '{LINK}'\"""", more="--seconds 2"),
        Step(f"telepulse simulate radial --link '{LINK}'", more="--seconds 1"),
        Step(
            "telepulse simulate radial --link 'delay=40ms,cut.from=10s,cut.for=2s'",
            more="--seconds 13",
        ),
        Step("telepulse scenes list", says="wan"),
        Step("telepulse scenes show wan", says="[display.actuator]"),
        Step("telepulse scenes copy radial my_scene.toml", says="my_scene.toml: a copy"),
        Step("telepulse simulate radial --details", more="--seconds 2", says="in phase"),
        Step("telepulse simulate my_scene.toml", more="--seconds 1"),
        Step("telepulse simulate my_scene.toml --details", more="--seconds 2", says="in phase"),
        Step("sensing-node radial", more=SERVED, shows=STREAMING),
        *on_air("display-node radial", more=FROM_THERE),
        Stop("sensing-node radial"),
    ],
    "recording": [
        Step(SENSE, more=SERVED, shows=STREAMING),
        Step(
            f"{PLAY} --record pulse.mcap",
            more=f"{FROM_THERE} --telemetry tcp://127.0.0.1:PORT",
            shows="playing",
        ),
        Step("telepulse record tcp://127.0.0.1:PORT pulse.mcap", more="--seconds 1", at="beside"),
        Step(
            "telepulse record tcp://127.0.0.1:PORT pulse.mcap --marks --about subject=S01"
            " --about side=left",
            more="--seconds 1",
            at="marked",
        ),
        Step('telepulse mark tcp://127.0.0.1:PORT "cuff on"', says="mark: cuff on"),
        Step("telepulse lsl tcp://127.0.0.1:PORT", more="--seconds 1"),
        Stop(f"{PLAY} --record pulse.mcap"),
        Stop(SENSE),
        Step("telepulse replay pulse.mcap", more=f"{SERVED} --seconds 1"),
        Step("telepulse export pulse.mcap --to csv"),
        Step("telepulse export pulse.mcap --to mcap"),
        Step("telepulse export pulse.mcap --to parquet"),
        Step("telepulse export pulse.mcap --to edf"),
        Step("telepulse export pulse.mcap --to wfdb"),
        Step("telepulse export pulse.mcap --to xdf"),
        Step("telepulse report pulse.mcap"),
        snippets_of("docs/analysis.md"),
    ],
    "plug-ins": [
        Step("telepulse plugins", says="telepulse.predictors  stack"),
        snippets_of("docs/howto/plugins.md"),
    ],
    "a recording of others": [
        lambda folder: wfdb_record(folder, pulse_and_ecg(), name="03700181") and None,
        Step("telepulse demo --source 03700181", more="--seconds 2 --no-ui", says="plays ABP"),
        Step("telepulse simulate --source 03700181 --channel RESP", more="--seconds 2"),
        Step("sensing-node radial --source 03700181", more=f"{SERVED} --seconds 1"),
    ],
    "one machine": [
        Step(f"{SENSE} --metrics 9101", more=SERVED, shows=STREAMING),
        Step(
            f"{PLAY} --connect tcp://127.0.0.1:5555 --metrics 9100",
            more="--telemetry tcp://127.0.0.1:PORT",
            shows="playing",
        ),
        Step("telepulse view tcp://127.0.0.1:PORT", shows="http://127"),
        Stop("telepulse view tcp://127.0.0.1:PORT"),
        Stop(f"{PLAY} --connect tcp://127.0.0.1:5555 --metrics 9100"),
        *on_air(f"{PLAY} --realtime fifo=40,lock,slack", more=FROM_THERE),
        Step("display-node --doctor scenes/radial.toml", more="--seconds 0.5", says="ticks"),
    ],
    "demo and simulation": [
        Step(
            f"""make demo ARGS="--seconds 5 --json out.json --link '{LINK}' --no-ui\"""",
            more="--seconds 2",
        ),
        felt("out.json"),
        Step("telepulse simulate radial", more="--seconds 1"),
        Step("telepulse simulate radial --seconds 60", more="--seconds 1"),
        Step(f"telepulse simulate radial --link '{LINK}' --json out.json", more="--seconds 1"),
        Step(
            "telepulse simulate wan"
            " --link 'delay=40ms,loss=1%,cut.from=10s,cut.for=2s,transport=tcp'",
            more="--seconds 13",
        ),
        loads,
        Step("telepulse calibrate loads.csv"),
    ],
    "experiment": [
        Step("telepulse experiment new mine.toml"),
    ],
    "emulated bench": [
        Step("telepulse emulate sensor radial --link /tmp/board", shows="kind"),
        Stop("telepulse emulate sensor radial --link /tmp/board"),
        Step("telepulse emulate tmcl SCENE --link /tmp/drive --film-link /tmp/film", shows="film"),
        Stop("telepulse emulate tmcl SCENE --link /tmp/drive --film-link /tmp/film"),
        Step(
            "telepulse emulate sensor real_bench --link /tmp/telepulse-board --delivery-ms 4",
            shows="kind",
        ),
        Step(
            "telepulse emulate tmcl tmcl_bench --link /tmp/telepulse-drive"
            " --film-link /tmp/telepulse-film",
            shows="film",
        ),
        Step("sensing-node scenes/tmcl_bench.toml", more=SERVED, shows="streaming"),
        # On a busy machine a fault may end it, by status 3; `test_emulated_bench.py` judges that.
        Step(
            "display-node scenes/tmcl_bench.toml",
            more=FROM_THERE,
            shows="playing|fault",
            statuses=(0, 3),
        ),
    ],
}

# The reason why a command is not run here, and the test of a similar one. The real command line
# still parses it, and the named tests must exist.
BENCH = "half a minute; tests/system/commissioning/test_bench_command.py"
FUZZ = "a minute and more; tests/system/hostile/test_fuzz_runner.py"
COMPILED = "installs, and compiles for a minute; tests/system/compiled"
MULTICAST = "needs a network that carries multicast; tests/system/discovery"
OBSERVER = "a minute; tests/system/experiment/test_experiment_command.py"
SUBJECT = "asks a person; tests/system/experiment"
PRESSED = "tests/system/drives/test_pressed_wrist.py"
THREE = "tests/system/drives/test_several_drives.py"
EXAMPLE = "tests/system/plugins/test_example.py installs and simulates it"
UNRUN = {
    f"{SSH} -R 5655:localhost:5555 -R 5656:localhost:5556 THIRD cat": BEHIND,
    f"{SSH} -L 5655:localhost:5655 -L 5656:localhost:5656 THIRD cat": BEHIND,
    "wg-quick up ./wg0.conf": BEHIND,
    "sensing-node radial --bind tcp://127.0.0.1:5555 --key keys/wrist.key": BEHIND,
    "display-node radial --connect tcp://localhost:5655 --key keys/finger.key --peer wrist.pub": (
        BEHIND
    ),
    "sensing-node radial --bind tcp://10.9.0.2:5555 --key keys/wrist.key": BEHIND,
    "display-node radial --connect tcp://10.9.0.2:5555 --key keys/finger.key --peer wrist.pub": (
        BEHIND
    ),
    PROTECTED.replace("scenes/radial.toml", "radial"): "run above, with the scene's file",
    AT_THE_FINGER.replace("scenes/radial.toml", "radial"): "run above, with the scene's file",
    "telepulse experiment run mine.toml --log anna.jsonl": SUBJECT,
    "telepulse experiment run mine.toml --log try.jsonl --without-drive": SUBJECT,
    "telepulse experiment run mine.toml --log anna.jsonl --resume": SUBJECT,
    "telepulse experiment run mine.toml --log o.jsonl --observer '5 %'": OBSERVER,
    f"{PROTECTED} --announce": MULTICAST,
    f"{PLAY} --discover --key keys/finger.key --peer wrist.pub": MULTICAST,
    f"{PLAY} --named 'radial pulse on ward-3' --key keys/finger.key --peer wrist.pub": MULTICAST,
    "telepulse discover": MULTICAST,
    "curl -s http://127.0.0.1:9100/metrics": "a reader's own; tests/system/metrics",
    "promtool check config docs/monitoring/prometheus.yml": PROMETHEUS,
    "prometheus --config.file docs/monitoring/prometheus.yml --web.listen-address 127.0.0.1:9090": (
        PROMETHEUS
    ),
    "pip install ./examples/plugin": EXAMPLE,
    "telepulse simulate examples/plugin/scene.toml --seconds 5": EXAMPLE,
    "make test": "is what runs this",
    "make test-all": "is what runs this",
    "make machines": "two minutes a variant; .ci/run",
    "make size": "counts lines",
    "telepulse demo": "make demo, run above",
    "source .venv/bin/activate": "the shell's own",
    "pre-commit install": "writes into .git; tests/system/documentation/test_habits.py",
    "python -m sphinx -W --keep-going -n docs out/docs": "tests/system/documentation/test_site.py",
    "make install COMPILED=1": COMPILED,
    "make demo COMPILED=1": COMPILED,
    "make wheels": COMPILED,
    "telepulse --version": "tests/unit/telepulse/cli/test_programs.py",
    "make bench ARGS=wire": "a minute",
    "docker compose up": COMPOSE,
    "TELEPULSE_SECONDS=300 docker compose --profile view --profile wan up": COMPOSE,
    "make report": "a minute; tests/system/paper/test_paper_command.py",
    "make bench": "an hour",
    'make demo ARGS="--seconds 300"': "five minutes; the like is run above",
    "make bench ARGS=load": "minutes",
    "make fuzz": FUZZ,
    'make fuzz ARGS="--seconds 600"': FUZZ,
    'make fuzz ARGS="--only frame --seconds 300"': FUZZ,
    'make soak ARGS="--minutes 20 --seed 7"': "20 minutes; tests/system/soak/test_run.py",
    "telepulse paper": "half a minute; tests/system/paper/test_paper_command.py",
    "telepulse study integrators": "half a minute; tests/system/reports/test_study_command.py",
    "telepulse study playout": "minutes; tests/system/reports/test_playout_study.py",
    "telepulse study prediction": "minutes; tests/system/reports/test_prediction_study.py",
    "telepulse study link": "minutes; tests/system/reports/test_link_study.py",
    "telepulse study announce": "minutes; tests/unit/telepulse/reports/studies",
    "telepulse study announce --records FOLDER": "needs records of PhysioNet",
    "telepulse demo announce": "as of radial; tests/unit/display_node/test_announced_stream.py",
    "telepulse study depth": "minutes; tests/system/reports/test_sweep_command.py",
    "telepulse sweep": "as in tests/system/reports/test_sweep_command.py",
    "telepulse sweep --ramp 90": "tests/unit/display_node/press/test_sweep.py",
    "telepulse sweep --connect tcp://HOST:5555 --key keys/finger.key --peer keys/wrist.pub"
    " --page --record sweep.mcap": "tests/system/reports/test_sweep_command.py",
    "telepulse replay sweep.mcap --press": "tests/system/reports/test_sweep_command.py",
    "telepulse study press": "minutes; tests/system/reports/test_press_study.py",
    "telepulse study press --check": "minutes; tests/unit/telepulse/cli/test_study_check.py",
    "telepulse demo press --link 'delay=150ms,jitter=15ms,loss=1%'": (
        "15 s; tests/system/nodes/test_press_nodes.py"
    ),
    "telepulse demo three_fingers --link 'delay=40ms,jitter=10ms,loss=1%'": (
        "seconds; tests/system/demo/test_demo.py"
    ),
    "telepulse study cost": "minutes; tests/system/reports/test_cost_study.py",
    "telepulse tune checked.toml": "of a bench that was there",
    "display-node checked.toml --connect tcp://HOST:5555 --key keys/finger.key --peer wrist.pub": (
        "of a bench that was there"
    ),
    "telepulse scenes copy tmcl_bench my_bench.toml": "as of radial, run above",
    "telepulse bench my_bench.toml --only display": BENCH,
    "telepulse bench my_bench.toml --only display --write checked.toml --out out/bench": BENCH,
    "telepulse bench real_bench": BENCH,
    "telepulse emulate sensor real_bench --link /tmp/telepulse-board --delivery-ms 4"
    " --still": BENCH,
    "telepulse bench tmcl_bench": BENCH,
    "telepulse bench tmcl_bench --only sensing": BENCH,
    "telepulse bench tmcl_bench --only display": BENCH,
    "sensing-node tmcl_bench --bind tcp://127.0.0.1:5555": "the bench page, run above",
    "display-node tmcl_bench --connect tcp://127.0.0.1:5555": "as above",
    "telepulse scenes copy real_press my_press.toml": PRESSED,
    "telepulse emulate tmcl real_press --wrist press --link /tmp/telepulse-probe"
    " --film-link /tmp/telepulse-wrist": PRESSED,
    "telepulse bench my_bench.toml --only display --contactor guan": BENCH,
    "telepulse emulate sensor three_fingers --link /tmp/telepulse-board --delivery-ms 4": THREE,
    "telepulse emulate tmcl three_fingers_bench --contactor cun"
    " --link /tmp/telepulse-drive-cun --film-link /tmp/telepulse-film-cun": THREE,
    "telepulse emulate tmcl three_fingers_bench --contactor guan"
    " --link /tmp/telepulse-drive-guan --film-link /tmp/telepulse-film-guan": THREE,
    "telepulse emulate tmcl three_fingers_bench --contactor chi"
    " --link /tmp/telepulse-drive-chi --film-link /tmp/telepulse-film-chi": THREE,
    "sensing-node three_fingers_bench --bind tcp://127.0.0.1:5555": THREE,
    "display-node three_fingers_bench --connect tcp://127.0.0.1:5555": THREE,
    "sensing-node real_press": PRESSED,
    "display-node real_press": PRESSED,
    "telepulse emulate tmcl my_bench.toml --link drive --film-link film": BENCH,
    "telepulse emulate cia402 SCENE --interface udp_multicast --channel 239.74.163.2": (
        "needs multicast; tests/system/drives/test_drive_commands.py"
    ),
    'telepulse calibrate --scene my_bench.toml --at finger --loads "0, 0.5, 1, 1.5, 1, 0.5, 0 N"': (
        "asks for loads to be put on a film; tests/system/commissioning"
    ),
    "sensing-node SCENES/tmcl_bench.toml --bind tcp://127.0.0.1:5555": "the bench page, run above",
    "display-node SCENES/tmcl_bench.toml --connect tcp://127.0.0.1:5555": "as above",
}
