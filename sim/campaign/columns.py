"""The columns of a campaign's results: name, type and description, as in the metadata of the Parquet file."""

from dataclasses import dataclass

from models.roads.iri import SHORTEST
from sim.campaign.file import Campaign
from sim.studies.ride.expected import APPROXIMATE
from sim.studies.ride.metrics import Metric, metrics_of
from sim.studies.ride.run_metrics import ABOUT_IRI, UNIT, roughness_names

EXPECTED, LINEAR = "expected_", "linear_"

PROMPT = "linear controllers that act at every timestep, without delay, noise and quantisation, and passive"
WITHOUT = f"{PROMPT}; of vehicles without curves, and without adjustable dampers but where these are asked for nothing"
LINEAR_IS = (
    "of the exact linear response over the same road, of a vehicle without limits; there for roads without a spectrum "
    f"and {WITHOUT}"
)
EXPECTED_IS = (
    "over all roads of the class, from the spectrum, of a vehicle without limits, noise and quantisation; {}; by statistical "
    "linearisation of a vehicle with curves; there for random roads and stable loops"
)
IRI_IS = f"{ABOUT_IRI}; null for a road shorter than {SHORTEST:g} m, one measured too coarsely, and a test rig's"
ROOT = "of a root of a mean square the root of the expected mean square"


@dataclass(frozen=True)
class Column:
    """Column of the results.

    Attributes:
        kind: int, float or str.
        about: metadata of the column: `unit`, `definition` and, for an approximate expectation, `approximate`.
    """

    kind: type
    about: dict[str, str]


def columns(campaign: Campaign) -> dict[str, Column]:
    """Every column of the results by name, in order."""
    metrics = {metric.name: metric for vehicle in campaign.vehicles.values() for metric in metrics_of(vehicle, campaign.loaded)}
    rough = dict.fromkeys(name for vehicle in campaign.vehicles.values() for name in roughness_names(vehicle))
    sampled = dict.fromkeys(name for samples in campaign.samples.values() for name in samples[0])
    laws = [variants[0] for of_vehicle in campaign.variants.values() for variants in of_vehicle.values()]
    drawn = dict.fromkeys(key for values in laws for key in values)
    variant = (
        {"variant": Column(int, {"definition": "number of the variant of a law that is drawn; null for others"})} if laws else {}
    )
    return {
        "run": Column(int, {}),
        "vehicle": Column(str, {}),
        "controller": Column(str, {}),
        "road": Column(str, {}),
        "speed": Column(float, {"unit": "m/s"}),
        "seed": Column(int, {"definition": "of a random road; null for others"}),
        "sample": Column(int, {"definition": "number of the sample of the parameters; null where none are sampled"}),
        **{f"parameter_{name}": Column(float, {"unit": "SI"}) for name in sampled},
        **variant,
        **{f"law_{key}": Column(float, {"unit": "SI", "definition": "key of the drawn law; null without it"}) for key in drawn},
        **{name: Column(float, {"unit": UNIT, "definition": IRI_IS}) for name in rough},
        "reason": Column(str, {"definition": "why the run has no metrics; null where it has"}),
        "diverged_at": Column(float, {"unit": "s"}),
        "ended_by": Column(str, {"definition": "what ended the linear regime first; null for nothing"}),
        "ended_at": Column(float, {"unit": "s"}),
        "linear_error": Column(
            float,
            {
                "unit": "-",
                "definition": "largest difference of a state from the exact linear response until then, over its peak; there for "
                f"{WITHOUT}",
            },
        ),
        "settled": Column(
            float,
            {
                "unit": "-",
                "definition": "variance when measuring begins over what it comes to, of the measured signal furthest from 1",
            },
        ),
        "settled_signal": Column(str, {"definition": "that signal"}),
        "expected_error": Column(
            float, {"unit": "-", "definition": f"what the integrals of the {EXPECTED} columns are off, relative, at most"}
        ),
        **{name: Column(float, {"unit": metric.unit, "definition": "in MuJoCo"}) for name, metric in metrics.items()},
        **{f"{LINEAR}{name}": Column(float, {"unit": one.unit, "definition": LINEAR_IS}) for name, one in metrics.items()},
        **{f"{EXPECTED}{name}": Column(float, _expected(metric)) for name, metric in metrics.items()},
    }


def described(campaign: Campaign) -> dict[str, dict[str, str]]:
    """Describes the columns, as a folder's manifest keeps them: types and properties."""
    return {name: {"type": column.kind.__name__, **column.about} for name, column in columns(campaign).items()}


def _expected(metric: Metric) -> dict[str, str]:
    root = "of the VDV the fourth root of its expected fourth power" if metric.name.endswith("_vdv") else ROOT
    about = {"unit": metric.unit, "definition": EXPECTED_IS.format(root)}
    return about | ({"approximate": "yes"} if metric.name.endswith(APPROXIMATE) else {})
