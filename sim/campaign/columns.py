"""The columns of a campaign's results: name, type and description, as in the metadata of the Parquet file."""

from collections.abc import Mapping

import pyarrow as pa

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
INTEGER, NUMBER, TEXT = pa.int64(), pa.float64(), pa.string()


def columns(campaign: Campaign, metadata: Mapping[str, str]) -> pa.Schema:
    """Returns every column of the results, in order, with its unit and definition; `metadata` are of the whole file."""
    metrics = {metric.name: metric for vehicle in campaign.vehicles.values() for metric in metrics_of(vehicle, campaign.loaded)}
    rough = dict.fromkeys(name for vehicle in campaign.vehicles.values() for name in roughness_names(vehicle))
    sampled = dict.fromkeys(name for samples in campaign.samples.values() for name in samples[0])
    laws = [variants[0] for of_vehicle in campaign.variants.values() for variants in of_vehicle.values()]
    of_law = "key of the drawn law; null without it"
    error = "largest difference of a state from the exact linear response until then, over its peak; there for "
    begun = "variance when measuring begins over what it comes to, of the measured signal furthest from 1"
    fields = [
        _column("run", INTEGER),
        _column("vehicle", TEXT),
        _column("controller", TEXT),
        _column("road", TEXT),
        _column("speed", unit="m/s"),
        _column("seed", INTEGER, "of a random road; null for others"),
        _column("sample", INTEGER, "number of the sample of the parameters; null where none are sampled"),
        *(_column(f"parameter_{name}", unit="SI") for name in sampled),
        *([_column("variant", INTEGER, "number of the variant of a law that is drawn; null for others")] if laws else []),
        *(_column(f"law_{key}", NUMBER, of_law, "SI") for key in dict.fromkeys(key for values in laws for key in values)),
        *(_column(name, NUMBER, IRI_IS, UNIT) for name in rough),
        _column("reason", TEXT, "why the run has no metrics; null where it has"),
        _column("diverged_at", unit="s"),
        _column("ended_by", TEXT, "what ended the linear regime first; null for nothing"),
        _column("ended_at", unit="s"),
        _column("linear_error", NUMBER, f"{error}{WITHOUT}", "-"),
        _column("settled", NUMBER, begun, "-"),
        _column("settled_signal", TEXT, "that signal"),
        _column("expected_error", NUMBER, f"what the integrals of the {EXPECTED} columns are off, relative, at most", "-"),
        *(_column(name, NUMBER, "in MuJoCo", metric.unit) for name, metric in metrics.items()),
        *(_column(f"{LINEAR}{name}", NUMBER, LINEAR_IS, metric.unit) for name, metric in metrics.items()),
        *(_expected(metric) for metric in metrics.values()),
    ]
    return pa.schema(fields, metadata=dict(metadata))


def _column(name: str, kind: pa.DataType = NUMBER, definition: str = "", unit: str = "", **more: str) -> pa.Field:
    about = {"unit": unit, "definition": definition, **more}
    return pa.field(name, kind, metadata={key: text for key, text in about.items() if text} or None)


def _expected(metric: Metric) -> pa.Field:
    root = "of the VDV the fourth root of its expected fourth power" if metric.name.endswith("_vdv") else ROOT
    approximate = {"approximate": "yes"} if metric.name.endswith(APPROXIMATE) else {}
    return _column(f"{EXPECTED}{metric.name}", NUMBER, EXPECTED_IS.format(root), metric.unit, **approximate)
