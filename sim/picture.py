"""What all pictures share: asked for before the work, drawn without a screen, never half-written."""

from pathlib import Path
from typing import TYPE_CHECKING

from models.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg")


def check_picture(path: Path) -> None:
    """Whether a picture can be drawn there, before the work.

    Raises:
        InputError: another kind of file, a folder that is not there, or matplotlib is not installed.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"picture {path}: not a kind of picture that is drawn; give a name that ends in {' or '.join(SUFFIXES)}")
    if not path.parent.is_dir():
        raise InputError(f"picture {path}: there is no folder {path.parent}; make it or give another")
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise InputError("pictures need matplotlib; pip install 'roadproof[report]' or leave --picture out") from None


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure [inches] that needs no screen."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: "Figure", path: Path) -> None:
    """Writes a figure whole, or not at all; the same figure gives the same bytes.

    Raises:
        InputError: it cannot be written.
    """
    import matplotlib

    beside = path.with_name(f".{path.stem}.part{path.suffix}")
    dateless = {"Date": None} if path.suffix.lower() == ".svg" else {}
    try:
        with matplotlib.rc_context({"svg.hashsalt": "roadproof"}):
            figure.savefig(beside, dpi=130, metadata=dateless)
        beside.replace(path)
    except OSError as error:
        raise InputError(f"picture {path}: cannot be written ({error.strerror}); give another") from error
    finally:
        beside.unlink(missing_ok=True)
