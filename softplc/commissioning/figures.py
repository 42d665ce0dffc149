"""Figures as PNG bytes: the same numbers give the same bytes, and nothing is left behind on the disk."""

import io
import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from softplc.errors import SoftplcError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MEASURED = "#b3b3b3"
ESTIMATE = "#ef7d00"
TRUTH = "#1f2933"
SECOND = "#1769aa"
THIRD = "#2e8b57"
WRONG = "#c62828"
BAND = "#f1f3f5"

DPI = 120
_STYLE: dict[str, Any] = {
    "figure.dpi": DPI,
    "figure.constrained_layout.use": True,
    "figure.constrained_layout.h_pad": 0.1,
    "figure.constrained_layout.w_pad": 0.1,
    "font.family": "DejaVu Sans",  # comes with matplotlib, so that every machine draws the same
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a94a0",
    "axes.labelcolor": TRUTH,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.limits": (-4, 5),
    "axes.formatter.use_mathtext": True,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "xtick.color": "#4a5560",
    "ytick.color": "#4a5560",
}


@contextmanager
def drawing() -> Iterator[None]:
    """Makes matplotlib ready for `new` and `png`; its caches live in a temporary folder that goes with the context.

    Raises SoftplcError where matplotlib is not installed. MPLCONFIGDIR is honoured where it is set.
    """
    with tempfile.TemporaryDirectory(prefix="softplc-study-") as folder:
        given = os.environ.get("MPLCONFIGDIR")
        os.environ["MPLCONFIGDIR"] = given or folder
        logging.getLogger("matplotlib").setLevel(logging.ERROR)  # that its font cache takes a while concerns nobody
        try:
            matplotlib = _matplotlib()
            with matplotlib.rc_context():
                matplotlib.rcdefaults()  # a matplotlibrc of the user must not change what a study looks like
                matplotlib.rcParams.update(_STYLE)
                yield
        finally:
            if given is None:
                del os.environ["MPLCONFIGDIR"]


def _matplotlib() -> Any:
    try:
        import matplotlib as mpl  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise SoftplcError(
            'figures need matplotlib, which is not installed: pip install "softplc[study]", or pip install matplotlib'
        ) from error
    return mpl


def new(width: float = 9.0, height: float = 3.6) -> "Figure":
    """An empty figure of so many inches; it belongs to nobody but the caller. Only within `drawing`."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    return Figure(figsize=(width, height))


def png(figure: "Figure") -> bytes:
    """The figure as a PNG file, without date and version in it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415

    FigureCanvasAgg(figure)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None}, facecolor=figure.get_facecolor())
    return file.getvalue()


def legend(axes: "Axes", **options: Any) -> None:
    """A legend in one row above the axes, where no line runs; beside a title, which is at the left."""
    columns = len(axes.get_legend_handles_labels()[0])
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, ncols=columns, **options)
