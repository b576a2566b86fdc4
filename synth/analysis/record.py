"""Certificates as plain data that can be written to logs and to vehicle files with designed gains.

A record contains the numbers that a check cannot recompute: the matrix X of (20), and the dual certificates of the lower bound.
A record also contains the claimed norm and bounds, so that a check can compare these claims with the recomputed values.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names, short_repr
from models.common.extensions import FEATURES
from models.common.printed import exactly
from synth.analysis.certificate import Certificate, eta_of
from synth.analysis.lower_bounds.invariant_point import limit_at as proved_at
from synth.analysis.lower_bounds.lower_bound import DualCertificate, LowerBound, SampledBound, prove_lower_bound
from synth.analysis.specification import SAMPLED_NORM
from synth.plant.generalized import Plant

if TYPE_CHECKING:
    from synth.analysis.lower_bounds.interpolation import Zeros
    from synth.analysis.sampled_loop import SampledDataProblem


# keys of the lower bound on the gain of a sampled-data loop; the bound holds for controllers of any order
SAMPLED_BOUND, SAMPLED_PROOF = "sampled_lower_bound", "sampled_proof"
# key under which a record stores the numbers that the vehicle file contained when the certificate was made, by section
VEHICLE = "vehicle"
CLAIMS = ("norm", "peak_frequency", "bound", "lower_bound", SAMPLED_NORM, SAMPLED_BOUND)
PROOFS = ("X", "limit_at", "zeros", "state", "observer", SAMPLED_PROOF, VEHICLE)
LOWER_PROOFS = ("limit_at", "zeros", "state", "observer")
MAY_BE_ZERO = ("norm", "peak_frequency", "limit_at", SAMPLED_NORM)
# limits for the magnitude of numbers in a certificate, in SI units; the numbers of vehicles are far within these limits
SMALLEST, LARGEST = 1e-60, 1e60
SAME = 1e-9  # allowed relative difference between the results of two computers, which may round differently


def to_record(certificate: Certificate) -> dict[str, Any]:
    """Returns the claims and proofs of a certificate in a form for JSON and TOML, without absent or infinite values."""
    below = certificate.below
    record: dict[str, Any] = {
        "norm": certificate.norm.value,
        "peak_frequency": certificate.norm.peak_frequency,
        "bound": certificate.bound,
        "lower_bound": certificate.lower_bound,
        "X": certificate.proof.X.tolist() if certificate.proof is not None else None,
        **(_proof_record(below) if below is not None else {}),
    }
    return {
        key: value for key, value in record.items() if value is not None and (not isinstance(value, float) or np.isfinite(value))
    }


def bound_record(bound: SampledBound | None) -> dict[str, Any]:
    """Returns the lower bound of a sampled-data loop and the proof of this bound, in the format of a record; empty if there is
    no bound.
    """
    return {SAMPLED_BOUND: bound.level, SAMPLED_PROOF: _proof_record(bound.proof)} if bound is not None else {}


def _proof_record(below: LowerBound) -> dict[str, Any]:
    """Returns the proof of a lower bound as plain data."""
    record: dict[str, Any] = {"limit_at": below.limit_at} if below.limit_at is not None else {}
    if below.zeros:
        record["zeros"] = [[[zero.real, zero.imag] for zero in kind] for kind in below.zeros]
    for name, dual in (("state", below.state), ("observer", below.observer)):
        if dual is not None:
            record[name] = {"X": dual.X.tolist(), "eta": float(dual.eta)}
    return record


def read_proof(record: Mapping[str, Any], plant: Plant, kept: int = 0) -> tuple[Array | None, float | None, LowerBound]:
    """Returns X and eta of (20), and the lower bound that the record proves. All results are computed with numpy only.

    If X or eta is absent, X and eta are both None.

    Args:
        record: record from `to_record`.
        plant: plant with n states, without the states of the controller.
        kept: number of controller states; X has rows and columns for the states of the controller, too.

    Raises:
        InputError: a key is unknown, or the value of a key is null or malformed.
    """
    for key in record:
        if key not in CLAIMS + PROOFS:
            raise InputError(f"a certificate has the unknown key {key!r}; known keys: {list_names(CLAIMS + PROOFS)}")
        if record[key] is None:
            raise InputError(
                f"{key} in a certificate has the value null; delete this key, or save the controller again to renew "
                "its certificate"
            )
    n = len(plant.A)
    for key in ("norm", "peak_frequency", "lower_bound", SAMPLED_NORM, SAMPLED_BOUND):
        _number(record, key)
    X = _matrix(record, "X", (n + kept, n + kept))
    if X is not None:
        if not np.all(np.diagonal(X) >= SMALLEST):
            raise InputError(
                f"X = {short_repr(record['X'])} in a certificate is not positive definite, because a diagonal entry is below "
                f"{SMALLEST:g}; save the controller again to renew its certificate"
            )
        size = np.sqrt(np.abs(np.diagonal(X)))
        if np.any(np.abs(X - X.T) > SAME * np.outer(size, size)):
            raise InputError("X in a certificate is not symmetric; save the controller again to renew its certificate")
    bound = _number(record, "bound")
    eta = eta_of(bound) if bound is not None else None
    lower_bound = _prove_bound(record, plant)
    return (X, eta, lower_bound) if X is not None and eta is not None else (None, None, lower_bound)


def read_sampled_bound(record: Mapping[str, Any], problem: "SampledDataProblem") -> SampledBound:
    """Returns the lower bound of a sampled-data loop that a record claims, and whether its proof holds; see `bound_record`.

    Raises:
        InputError: the proof is malformed.
    """
    level, proof = _number(record, SAMPLED_BOUND), record.get(SAMPLED_PROOF, {})
    assert level is not None, "it is claimed"
    if not isinstance(proof, Mapping) or any(key not in LOWER_PROOFS for key in proof):
        raise InputError(
            f"{SAMPLED_PROOF} = {short_repr(proof)} in a certificate is not a table with {list_names(LOWER_PROOFS)}; save "
            "the controller again to renew its certificate"
        )
    plant = problem.at(level)
    if plant is None:
        return SampledBound(level, LowerBound(0.0), inside=True)
    return SampledBound(level, _prove_bound(proof, plant))


def _prove_bound(record: Mapping[str, Any], plant: Plant) -> LowerBound:
    """Returns the lower bound that follows from the proofs in a record. For arguments and errors, see the function
    `read_proof`.
    """
    lower_bound = LowerBound(0.0)
    limit_at = _number(record, "limit_at")
    if limit_at is not None:
        lower_bound = LowerBound(proved_at(plant, limit_at), limit_at=limit_at)
    zeros = _zeros(record)
    if zeros is not None:
        gamma = FEATURES.load("zeros").limit_at_zeros(plant, zeros)
        lower_bound = max(lower_bound, LowerBound(gamma, zeros=zeros), key=lambda each: each.gamma)
    state, observer = _dual_certificate(record, "state"), _dual_certificate(record, "observer")
    if state is not None:
        try:
            proved = prove_lower_bound(plant, state, observer)
        except ValueError as error:
            raise InputError(
                f"a certificate does not fit the vehicle: {error}; save the controller again to renew its certificate"
            ) from error
        lower_bound = proved if proved.gamma > lower_bound.gamma else lower_bound
    return lower_bound


def false_claims(record: Mapping[str, Any], certificate: Certificate) -> list[str]:
    """Returns descriptions of those claims in a record that differ from the recomputed certificate."""
    true_record = to_record(certificate)
    wrong = []
    if certificate.proof is None and "bound" in record:
        wrong.append(f"the certificate claims the bound {exactly(_number(record, 'bound'))}, but contains no X to prove it")
    if certificate.proof is None and "X" in record:
        wrong.append("the certificate contains an X, but no bound that it proves")
    peak = _number(record, "peak_frequency")
    if peak is not None and not certificate.peaks_at(peak):
        wrong.append(f"the certificate claims that the norm is reached at {exactly(peak)} rad/s, but it is not reached there")
    for claim in ("norm", "bound", "lower_bound"):
        claimed, true = _number(record, claim), true_record.get(claim)
        if claimed is None or (claim == "bound" and certificate.proof is None):
            continue
        zero_norm = claim == "norm" and certificate.norm.value <= certificate.norm_rounding
        allowed = certificate.norm_rounding if zero_norm else SAME * claimed
        if true is None or not abs(true - claimed) <= allowed:
            truth = exactly(true) if true is not None else "infinite" if claim == "norm" else "unproved"
            wrong.append(f"the certificate claims that the {claim.replace('_', ' ')} is {exactly(claimed)}, but it is {truth}")
    return wrong


def _number(record: Mapping[str, Any], key: str) -> float | None:
    value = record.get(key)
    if value is None:
        return None
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    zero = key in MAY_BE_ZERO and number and value == 0
    if not number or not (zero or SMALLEST <= value <= LARGEST):
        raise InputError(
            f"{key} = {short_repr(value)} in a certificate is not between {SMALLEST:g} and {LARGEST:g}; save the controller "
            "again to renew its certificate"
        )
    return float(value)


def _matrix(record: Mapping[str, Any], key: str, shape: tuple[int, int] | None = None) -> Array | None:
    value = record.get(key)
    if value is None:
        return None
    try:
        matrix = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        matrix = np.array(np.nan)
    if matrix.ndim != 2 or not np.all(np.abs(matrix) <= LARGEST) or (shape is not None and matrix.shape != shape):
        expected = f" of shape {shape}" if shape else ""
        raise InputError(
            f"{key} = {short_repr(value)} in a certificate is not a matrix{expected} of finite numbers up to "
            f"{LARGEST:g}; save the controller again to renew its certificate"
        )
    return matrix


def _zeros(record: Mapping[str, Any]) -> "Zeros | None":
    value = record.get("zeros")
    if value is None:
        return None
    try:
        of_z, of_y = (tuple(complex(float(real), float(imag)) for real, imag in kind) for kind in value)
        fits = all(np.isfinite(zero) for zero in (*of_z, *of_y))
    except (TypeError, ValueError, OverflowError):
        fits, of_z, of_y = False, (), ()
    if not fits:
        raise InputError(
            f"zeros = {short_repr(value)} in a certificate must be two lists, each with [real, imaginary] pairs of finite "
            "numbers; save the controller again to renew its certificate"
        )
    return of_z, of_y


def _dual_certificate(record: Mapping[str, Any], key: str) -> DualCertificate | None:
    value = record.get(key)
    if value is None:
        return None
    if not isinstance(value, Mapping):
        value = {}
    X, eta = _matrix(value, "X"), _number(value, "eta")
    if X is None or eta is None or X.shape[0] != X.shape[1]:
        raise InputError(
            f"{key} = {short_repr(value)} in a certificate has no square X, or no eta; save the controller again to renew its "
            "certificate"
        )
    return DualCertificate(X, eta)
