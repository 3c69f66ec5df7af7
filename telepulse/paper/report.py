"""The report of `telepulse paper`: the figures, filled into the text of `page.md`."""

import math
from typing import TYPE_CHECKING

from telepulse.document import Plot, Report, Table, percent, read_chapters
from telepulse.paper import (
    comparison,
    explicit_loop,
    gain_units,
    plots,
    published,
    pulse_spectrum,
    stability,
    stepper,
)

if TYPE_CHECKING:
    from jinja2 import Template

TITLE = "Dargahi, Xie and Ji (2008), recomputed"


def build_paper() -> Report:
    """Compute every figure, and report it. Raises SceneError or SourceError."""
    ours, rates = comparison.compare(), stability.measure()
    real = stepper.load_bench()
    on_film, shipped = stepper.run_on_film(real), stepper.run_scene(real)
    text = _template().render(
        paper=published,
        comparison=comparison,
        units=gain_units,
        loop=explicit_loop,
        pulse=pulse_spectrum,
        stability=stability,
        ours=ours,
        spectra=pulse_spectrum.spectra(),
        by_trapezoids={
            hz: pulse_spectrum.spectra()["ours"].below_by_trapezoids(hz)
            for hz in published.ENERGY_BELOW_HZ
        },
        following=[unit.name for unit in published.ERROR_UNITS if gain_units.follows(unit)],
        heights_n=[gain_units.height_n(published.FILM_MV, each) for each in published.PRINTED],
        bench=stepper.describe(real),
        shipped_n=shipped.force_rmse_n,
        rates=rates,
        diverged=[each for each in rates if math.isinf(each.explicit_n)],
        broken=[each for each in rates if math.isinf(each.shipped_n)],
    )
    named: dict[str, Table | Plot] = {
        **gain_units.tables(),
        **pulse_spectrum.tables(),
        **stepper.tables(),
        "rates": stability.rates_table(rates),
        **plots.plots(ours, on_film, shipped, rates),
    }
    return Report(TITLE, read_chapters(text, named))


def _template() -> "Template":
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        # A Markdown text: the document escapes what becomes part of its page.
        autoescape=False,
        loader=PackageLoader("telepulse.paper", "."),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "form": format,
        "mn": lambda force_n, form=".1f": f"{1e3 * force_n:{form}} mN",
        "percent": percent,
        "scientific": published.scientific,
    }
    return environment.get_template("page.md")
