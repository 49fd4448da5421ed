"""The diagnosis on a terminal."""

import math

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.terminal import print_verdict
from lerobot_act_chunking.diagnostics.resolution.reconstruction import Deviation
from lerobot_act_chunking.diagnostics.resolution.report import ResolutionReport
from lerobot_act_chunking.diagnostics.resolution.strides import Stride
from lerobot_act_chunking.diagnostics.resolution.verdict import MOST_ABOVE_NYQUIST


def print_report(report: ResolutionReport, console: Console) -> None:
    """Print every stride, what the judged one does to each dimension, and the verdict."""
    demonstrations, criteria = report.demonstrations, report.criteria
    title = f"Chunks of {criteria.horizon_s:g} s at {demonstrations.fps:g} Hz"
    console.print(f"[bold]{title}[/] [dim]({escape(demonstrations.folder)})[/]", soft_wrap=True)
    n_chunks = report.strides[0].reconstruction.n_chunks
    data = f"{n_chunks} chunks from {len(demonstrations.episodes)} episodes, sampled and interpolated:"
    console.print(data, highlight=False, soft_wrap=True)
    console.print(_strides_table(report))
    console.print(f"\nat chunk_stride={report.judged.stride}:", highlight=False)
    console.print(_dimensions_table(report))
    for note in report.notes:
        console.print(f"[dim]- {escape(note)}[/]", highlight=False)
    console.print(f"recommended: {report.flags}", highlight=False, soft_wrap=True, markup=False)
    print_verdict(report, console)


def _strides_table(report: ResolutionReport) -> Table:
    in_mm = report.tolerance.unit == "mm"
    names = ("rms \\[mm]", "95 %", "max") if in_mm else ("95 % of range",)
    table = Table(box=None, pad_edge=False)
    for name in ("stride", "every", "chunk_size", "per second", "energy above", *names):
        table.add_column(name, justify="right", no_wrap=True)
    for stride in report.strides:
        chosen = stride is report.recommended
        cells = _cells(stride, report)
        table.add_row(*(f"[green]{cell}[/]" if chosen else cell for cell in cells))
    return table


def _cells(stride: Stride, report: ResolutionReport) -> list[str]:
    above = f"{stride.nyquist_hz:.3g} Hz: {share(stride.above_nyquist)}"
    farthest = stride.reconstruction.farthest
    errors = [f"{stride.worst:.2%}"] if farthest is None else _figures(farthest)
    return [
        str(stride.stride),
        f"{stride.stride / stride.fps:.3g} s",
        str(stride.timing.chunk_size),
        f"{stride.predictions_per_second:.3g}",
        f"[yellow]{above}[/]" if stride.above_nyquist > MOST_ABOVE_NYQUIST else above,
        *errors,
    ]


def _dimensions_table(report: ResolutionReport) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("off by")
    for name in ("rms", "95 %", "max", "energy above Nyquist"):
        table.add_column(name, justify="right", no_wrap=True)
    found = report.judged.reconstruction
    above_nyquist = report.judged.dimensions_above_nyquist.tolist()
    for dim in report.floor.moving:
        deviation, above = found.dimensions[dim], above_nyquist[dim]
        table.add_row(escape(deviation.name), *_figures(deviation), share(above))
    for point in found.points:
        table.add_row(f"{escape(point.name)} \\[{report.measure.unit}]", *_figures(point), "")
    return table


def _figures(deviation: Deviation) -> list[str]:
    return [f"{value:.2g}" for value in (deviation.rms, deviation.p95, deviation.max)]


def share(value: float) -> str:
    """A share of the energy, small ones included."""
    if math.isnan(value):
        return "-"
    return "0" if value == 0 else f"{value:.1%}" if value >= 0.001 else f"{value:.0e}"
