"""Cost of a data frame on the wire: encode and decode, by its number of samples."""

from functools import partial

import numpy as np

from benchmarks.benchmark import Benchmark
from benchmarks.timing import time_call
from protocol.wire.messages import Frame, decode_frame, encode_frame


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    rows = []
    for samples, channels in ((1, 1), (5, 1), (5, 4), (50, 1)):
        values = np.linspace(0, 1, samples * channels, dtype="<f4").reshape(samples, channels)
        frame = Frame(1 << 60, 123_456, 987_654_321_000, 1_000_000, values)
        data = encode_frame(frame)
        encode_us = time_call(partial(encode_frame, frame))
        decode_us = time_call(partial(decode_frame, data))
        both_us = encode_us + decode_us
        costs = (f"{cost_us:.2f}" for cost_us in (encode_us, decode_us, both_us))
        rows.append((f"{samples} × {channels}", str(len(data)), *costs))
        if (samples, channels) == (5, 1):
            benchmark.judge("a frame of 5 samples, encoded and decoded", both_us * 1e-6)
    columns = ("samples × channels", "bytes", "encode µs", "decode µs", "both µs")
    benchmark.table("Data frames: median cost per frame", columns, rows)
