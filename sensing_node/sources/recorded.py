"""A recording as a source: signals of a file in any known format, played once or in a loop."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.config.quantities import MAX_NAME, Hertz, Newtons
from protocol.errors import SourceError
from protocol.wire.description import ANNOUNCE, PULSE, Channel, first_repeated
from protocol.wire.messages import LARGEST_N
from pulse_sensors.force_scale import FORCES, MILLIVOLTS, VOLTAGES, SensitivityTable
from pulse_sensors.sample_plausibility import RATE_TOLERANCE, unit_contradiction
from sensing_node.files.column_kind import PRESSURES
from sensing_node.files.formats import open_signals
from sensing_node.files.grids import fill_gaps, find_gaps
from sensing_node.files.recording_plausibility import (
    BLOCK,
    RecordedColumn,
    blocks,
    constant_column,
    examine,
    extremes,
    unusable_values,
)
from sensing_node.files.signal_choice import BEAT_N, NEWTONS_PER_MMHG, choose_pulse
from sensing_node.files.signals import ColumnKey, SignalFile, SignalInfo, aligned
from sensing_node.sources.source import SampleSource, SourceContext, SourceScene
from sensing_node.sources.synthetic import SyntheticScene

# Length of the stretches in which a beat's height is looked for: a beat or more.
BEAT_S = 1.5
# Conversion of some of a column's values into N or mV.
Scale = Callable[[NDArray[np.float64]], NDArray[np.float64]]


class RecordingScene(SensitivityTable, SourceScene):
    """The `source` table of kind "recording".

    path: a file in any format of docs/howto/bring_your_recording.md, relative to the scene's
    folder. column: name or number from 0 of a signal, column or array; by default, the one with
    the shape of a pulse. columns: several of them; each is a channel with the
    column's name. announce: column of an ECG, in announce_unit, which becomes the channel
    "announce". rate, unit, announce_unit: by default those of the file. unit: N or mN are used
    unchanged. V or mV are converted by the film: by film_radius with eq 21, or by sensitivity, such
    as 44 mV/N. mmHg and kPa become 7.5 mN/mmHg. "raw" is scaled to peak_to_peak, each column by
    itself, with the mean at preload. Any other unit of the file is scaled so that the median beat
    is peak_to_peak (0.3 N) high. inverted: the values fall where the pulse presses. preload: added
    force; by default 0.3 N where the scale is by peak_to_peak, as for a synthetic pulse, else 0 N.
    """

    kind: Literal["recording"]
    path: Path
    rate_hz: Annotated[Hertz, Field(ge=1, le=100_000)] | None = None
    unit: Literal["N", "mN", "V", "mV", "mmHg", "kPa", "raw"] | None = None
    column: ColumnKey | None = None
    columns: Annotated[tuple[ColumnKey, ...], Field(min_length=1, max_length=16)] | None = None
    announce: ColumnKey | None = None
    announce_unit: Literal["V", "mV", "uV"] | None = None
    peak_to_peak_n: Annotated[Newtons, Field(gt=0, le=10)] | None = None
    preload_n: Annotated[Newtons, Field(ge=0, le=10)] | None = None
    inverted: bool = False
    repeat: Literal["loop", "once"] = "loop"

    @model_validator(mode="after")
    def _has_a_scale(self) -> Self:
        if self.unit is not None:
            self.refuse_keys_beside(self.unit)
        if self.unit in VOLTAGES and not {"sensitivity", "film_radius"} & self.given:
            raise ValueError(
                f'unit "{self.unit}" needs film_radius or sensitivity to become a force'
            )
        if self.unit == "raw" and self.peak_to_peak_n is None:
            raise ValueError('unit "raw" needs peak_to_peak to become a force')
        if {"column", "columns"} <= self.given:
            raise ValueError("column is one, columns are several; give one of the two keys")
        if "announce_unit" in self.given and self.announce is None:
            raise ValueError("announce_unit needs announce, which is not given")
        return self

    def build(self, context: SourceContext) -> "RecordedSource":
        """See `SourceScene.build`."""
        try:
            return RecordedSource(self, context.folder, context.plausible)
        except MemoryError:
            raise SourceError(f"{self.path}: is too large for the memory; cut it") from None

    def unit_of(self, stated: str) -> str:
        """Return the unit that values are converted from; "beat": scaled by their median beat.

        stated: the file's unit, which may be empty.
        """
        if self.unit is not None:
            return self.unit
        if stated in VOLTAGES and {"sensitivity", "film_radius"} & self.given:
            return stated
        plain = (stated in FORCES or stated in PRESSURES) and "peak_to_peak" not in self.given
        return stated if plain else "beat"

    def rest_n(self, unit: str) -> float:
        """Return the force in N that is added, or that the mean of a scaled recording becomes."""
        if self.preload_n is not None:
            return self.preload_n
        return SyntheticScene(kind="synthetic").preload_n if unit in ("raw", "beat") else 0.0

    def scale(self, values: NDArray[Any], unit: str, rate_hz: float) -> Scale:
        """Return the conversion of some of a column's values into forces in N.

        values: all of the column, not all equal.
        """
        rest_n, sign = self.rest_n(unit), -1.0 if self.inverted else 1.0
        if unit in FORCES:
            return lambda some: some * sign * FORCES[unit] + rest_n
        if unit in PRESSURES:
            to_mmhg = PRESSURES[unit] / PRESSURES["mmHg"]
            return lambda some: some * sign * to_mmhg * NEWTONS_PER_MMHG + rest_n
        if unit in VOLTAGES:
            newtons = self.calibration().newtons
            return lambda some: newtons(some * sign * VOLTAGES[unit]) + rest_n
        height = _height(values) if unit == "raw" else beat_height(values, rate_hz)
        mean = sum(float(block.sum()) for block in blocks(values)) / len(values)
        gain = sign * ((self.peak_to_peak_n or BEAT_N) / height)
        return lambda some: rest_n + (some - mean) * gain


def beat_height(values: NDArray[Any], rate_hz: float) -> float:
    """Return the height of a usual beat: the median peak-to-peak value of stretches of 1.5 s.

    Of a signal that is constant most of the time, it is the greatest one.
    """
    width = min(len(values), max(2, round(BEAT_S * rate_hz)))
    heights = [
        np.ptp(block[: len(block) // width * width].reshape(-1, width), axis=1)
        for block in blocks(values, max(1, BLOCK // width) * width)
    ]
    return float(np.median(np.concatenate(heights))) or _height(values)


def _height(values: NDArray[Any]) -> float:
    low, high = extremes(values)
    return high - low


class RecordedSource(SampleSource):
    """A recorded pulse in N, one channel for each column; `warnings` lists doubtful properties.

    folder: of the scene's file. plausible: refuse values that cannot be a pulse with this scene.
    Raises SourceError if the file cannot be read or scaled, or its values are refused.
    """

    def __init__(self, scene: RecordingScene, folder: Path, plausible: bool = True) -> None:
        path = folder / scene.path
        file = open_signals(path)
        pulse_keys = scene.columns or (
            choose_pulse(file, scene.rate_hz).signal.number
            if scene.column is None
            else scene.column,
        )
        announcing = () if scene.announce is None else (scene.announce,)
        loaded = file.load((*pulse_keys, *announcing))
        self.warnings = [f"{path}: {note}" for note in file.notes]
        infos = self._described(file, loaded, scene.rate_hz)
        rate_hz = max(info.rate_hz or 0.0 for info in infos)
        loaded = self._on_one_grid(path, loaded, infos, rate_hz)
        pulses = loaded[: len(pulse_keys)]
        self._columns = list[tuple[NDArray[Any], Scale]]()
        for column, info in zip(pulses, infos, strict=False):
            constant, unit = constant_column(column), scene.unit_of(info.unit)
            if constant is not None and unit in ("raw", "beat"):
                raise SourceError(f"{path}: {constant}")
            if (contradiction := unit_contradiction(info.unit, unit)) is not None:
                raise SourceError(f"{path}: {column.title} {contradiction}")
            scale = scene.scale(column.values, unit, rate_hz)
            refusal, warnings = constant, list[str]()
            if constant is None:
                refusal, warnings = examine(column, scale, unit, scene.rest_n(unit))
            of_column = f"{column.title}: " if scene.columns else ""
            doubts = [
                f"{path}: {text if text.startswith('column ') else of_column + text}"
                for text in (warnings if refusal is None else [refusal])
            ]
            if refusal is not None and plausible:
                raise SourceError(doubts[0])
            # Those of the file itself are the same for each column.
            self.warnings += [doubt for doubt in doubts if doubt not in self.warnings]
            self._columns.append((column.values, scale))
        for column, info in zip(loaded[len(pulses) :], infos[len(pulses) :], strict=True):
            stated = info.unit if info.unit in MILLIVOLTS else "mV"
            to_mv = _announcing(column, scene.announce_unit or stated, path)
            self._columns.append((column.values, to_mv))
        self.channels = _channels(scene, pulses, path)
        self._loop = scene.repeat == "loop"
        self._position = 0
        self.period_ns = round(1e9 / rate_hz)
        if self._loop:
            self.repeats_after_s = len(self._columns[0][0]) / rate_hz

    def _described(
        self, file: SignalFile, loaded: list[RecordedColumn], rate_hz: float | None
    ) -> list[SignalInfo]:
        """Return what is known of columns, at a rate that overrides the first one's; warn of it."""
        if rate_hz is None:
            return [file.describe(column) for column in loaded]
        own_hz = None
        with suppress(SourceError):
            own_hz = file.describe(loaded[0]).rate_hz
        if own_hz is None:
            return [file.describe(column, rate_hz) for column in loaded]
        if abs(rate_hz / own_hz - 1) > RATE_TOLERANCE:
            self.warnings.append(
                f"{file.path}: rate {rate_hz:g} Hz overrides the {own_hz:.4g} Hz of the file"
            )
        infos = [file.describe(column) for column in loaded]
        scaled = [rate_hz * ((info.rate_hz or own_hz) / own_hz) for info in infos]
        return [info._replace(rate_hz=each) for info, each in zip(infos, scaled, strict=True)]

    def _on_one_grid(
        self, path: Path, loaded: list[RecordedColumn], infos: list[SignalInfo], rate_hz: float
    ) -> list[RecordedColumn]:
        """Return columns of one rate and length, their gaps filled; warn of each gap."""
        several, missing = len(loaded) > 1, set[int]()
        for column, info in zip(loaded, infos, strict=True):
            unusable = unusable_values(column.values)
            if unusable is not None:
                raise SourceError(f"{path}: {f'{column.title}: ' if several else ''}{unusable}")
            gaps = find_gaps(column.values)
            if gaps.samples:
                missing.add(column.number)
                text = gaps.text(len(column.values), info.rate_hz or rate_hz)
                self.warnings.append(f"{path}: {column.title}: {text}; straight lines replace them")
        filled = [
            fill_gaps(column.values) if column.number in missing else column.values
            for column in loaded
        ]
        pairs = zip(infos, filled, strict=True)
        if len({(info.rate_hz, info.begin_s, len(each)) for info, each in pairs}) == 1:
            return [replace(c, values=each) for c, each in zip(loaded, filled, strict=True)]
        grid = aligned(infos, filled, rate_hz)
        return [
            replace(column, values=fill_gaps(np.ascontiguousarray(values)))
            for column, values in zip(loaded, grid.T, strict=True)
        ]

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next samples, shape (count, channels); fewer at the end of one pass."""
        first, length = self._position, len(self._columns[0][0])
        last = first + count if self._loop else min(first + count, length)
        self._position = last
        places = np.arange(first, last) % length
        parts = [scale(values[places].astype(np.float64)) for values, scale in self._columns]
        return np.stack(parts, axis=1)

    def notes(self) -> list[str]:
        """See `SampleSource.notes`."""
        return list(self.warnings)


def _announcing(column: RecordedColumn, unit: str, path: Path) -> Scale:
    """Return the conversion into mV of a channel that announces. Raises SourceError."""
    constant = constant_column(column)
    if constant is not None:
        raise SourceError(f"{path}: announce: {constant}")
    low, high = extremes(column.values)
    largest_mv = max(-low, high) * MILLIVOLTS[unit]
    if largest_mv > LARGEST_N:
        raise SourceError(
            f'{path}: announce: {column.title} reaches {largest_mv:.4g} mV in unit "{unit}", which'
            " no frame can hold; set announce_unit"
        )
    return lambda some: some * MILLIVOLTS[unit]


def _channels(
    scene: RecordingScene, pulses: Sequence[RecordedColumn], path: Path
) -> tuple[Channel, ...]:
    """Return the channels, named by their columns; one `column` is "pulse". Raises SourceError."""
    names = [PULSE] if scene.columns is None else [c.name or f"column {c.number}" for c in pulses]
    for name in names:
        if not name.isprintable() or len(name) > MAX_NAME:
            raise SourceError(
                f"{path}: columns: the name {ascii(name)[:MAX_NAME]} cannot be a channel's, which"
                f" has at most {MAX_NAME} printable characters; rename the column, or give"
                " its number in a file without names"
            )
    announcing = () if scene.announce is None else (Channel(ANNOUNCE, "mV"),)
    repeated = first_repeated((*names, ANNOUNCE))
    if repeated is not None:
        raise SourceError(
            f"{path}: columns: two channels would have the name {repeated!r}; rename a column"
        )
    return (*(Channel(name) for name in names), *announcing)
