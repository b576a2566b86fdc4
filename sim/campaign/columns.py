"""The columns of a campaign's results: the metadata of the Parquet file contain the name, type, unit and definition of each
column.
"""

from collections.abc import Mapping

import pyarrow as pa

from models.roads.iri import SHORTEST
from sim.campaign.file import Campaign
from sim.studies.ride.metrics import Metric, metrics_of
from sim.studies.ride.run_metrics import ABOUT_IRI, UNIT, roughness_names

EXPECTED, LINEAR = "expected_", "linear_"

PROMPT = "linear controllers that act at every timestep, without delay, noise and quantisation, and passive"
WITHOUT = f"{PROMPT}, for vehicles without curves; with adjustable dampers only if the controller requests no force"
LINEAR_IS = (
    "value in the exact linear response over the same road, for a vehicle without limits; given only for roads that are not "
    f"random, and for {WITHOUT}"
)
EXPECTED_IS = (
    "expected value over all roads of the class, from the spectrum, for a vehicle without limits, noise and quantisation; {}; "
    "with curves by statistical linearisation; given only for random roads and stable loops"
)
IRI_IS = f"{ABOUT_IRI}; null for roads shorter than {SHORTEST:g} m, roads measured too coarsely, and test rigs"
INTEGER, NUMBER, TEXT = pa.int64(), pa.float64(), pa.string()


def columns(campaign: Campaign, metadata: Mapping[str, str]) -> pa.Schema:
    """Returns all columns of the results in order, each with a unit and a definition.

    Args:
        campaign: campaign to which the results belong.
        metadata: additional metadata for the Parquet file as a whole, by key.
    """
    metrics = {metric.name: metric for vehicle in campaign.vehicles.values() for metric in metrics_of(vehicle, campaign.loaded)}
    rough = dict.fromkeys(name for vehicle in campaign.vehicles.values() for name in roughness_names(vehicle))
    sampled = dict.fromkeys(name for samples in campaign.samples.values() for name in samples[0])
    laws = [variants[0] for of_vehicle in campaign.variants.values() for variants in of_vehicle.values()]
    of_law = "sampled value of this key of the control law; null for controllers without this key"
    error = (
        "largest difference of a state from the exact linear response until ended_at, relative to the peak of the state; "
        "only for "
    )
    begun = (
        "ratio of the variance at the start of the measurement to the final variance, for the signal whose ratio is "
        "furthest from 1"
    )
    fields = [
        _column("run", INTEGER),
        _column("vehicle", TEXT),
        _column("controller", TEXT),
        _column("road", TEXT),
        _column("speed", unit="m/s"),
        _column("seed", INTEGER, "seed of a random road; null for other roads"),
        _column("sample", INTEGER, "number of the sample of the parameters; null if no parameter is sampled"),
        *(_column(f"parameter_{name}", unit="SI") for name in sampled),
        *([_column("variant", INTEGER, "number of the variant of a sampled law; null for other controllers")] if laws else []),
        *(_column(f"law_{key}", NUMBER, of_law, "SI") for key in dict.fromkeys(key for values in laws for key in values)),
        *(_column(name, NUMBER, IRI_IS, UNIT) for name in rough),
        _column("reason", TEXT, "reason why the run has no metrics; null if the run has metrics"),
        _column("diverged_at", unit="s"),
        _column("ended_by", TEXT, "limit that ended the linear range; null if no limit was reached"),
        _column("ended_at", unit="s"),
        _column("linear_error", NUMBER, f"{error}{WITHOUT}", "-"),
        _column("settled", NUMBER, begun, "-"),
        _column("settled_signal", TEXT, "signal to which settled refers"),
        _column("expected_error", NUMBER, f"largest relative error of the integrals of the {EXPECTED} columns", "-"),
        *(_column(name, NUMBER, "value in MuJoCo", metric.unit) for name, metric in metrics.items()),
        *(_column(f"{LINEAR}{name}", NUMBER, LINEAR_IS, metric.unit) for name, metric in metrics.items()),
        *(_expected_column(metric) for metric in metrics.values()),
    ]
    return pa.schema(fields, metadata=dict(metadata))


def _column(name: str, kind: pa.DataType = NUMBER, definition: str = "", unit: str = "", **more: str) -> pa.Field:
    about = {"unit": unit, "definition": definition, **more}
    return pa.field(name, kind, metadata={key: text for key, text in about.items() if text} or None)


def _expected_column(metric: Metric) -> pa.Field:
    approximate = {"approximate": "yes"} if metric.approximate else {}
    return _column(f"{EXPECTED}{metric.name}", NUMBER, EXPECTED_IS.format(metric.expectation), metric.unit, **approximate)
