"""Session files for tests."""

from pathlib import Path

from telepulse.experiment.interval import PlayedInterval
from telepulse.experiment.session import Letter, SessionPlan, load_plan

BAD = "delay=40ms,jitter=5ms,loss=1%"


def condition(name: str, link: str = BAD, compensation: str = "0 ms") -> str:
    return f'[[conditions]]\nname = "{name}"\nlink = "{link}"\ncompensation = "{compensation}"\n'


def write(
    path: Path, *conditions: str, scene: str = "radial", kind: str = "abx", **keys: object
) -> Path:
    """Write a session file of short intervals."""
    values = {"interval": "0.1 s", "settle": "0 s", "seed": 1, "trials": 2} | keys
    lines = [f'scene = "{scene}"', f'kind = "{kind}"']
    lines += [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in values.items()]
    lines += conditions or [condition("all predicted")]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def plan(folder: Path, *conditions: str, **keys: object) -> SessionPlan:
    return load_plan(write(folder / "session.toml", *conditions, **keys))


def played(letter: Letter, on_link: bool, error_n: float) -> PlayedInterval:
    """Return the record of an interval with a force error."""
    return PlayedInterval(
        letter=letter,
        on_link=on_link,
        link_seed=0,
        foreperiod_s=1.0,
        felt_s=1.0,
        aligned_n=error_n,
        in_phase_n=error_n,
        roughness_felt_n=None,
        roughness_sensed_n=None,
        pulse_n=0.3,
        deadline_misses=0,
        ticks=1000,
        stale_ticks=0,
        longest_gap_ms=2.0,
    )
