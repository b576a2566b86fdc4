"""`python -m synth --certificates DIR`: writes LMI certificates to a folder, with the programs that check them."""

from collections.abc import Sequence
from pathlib import Path

from models.common.errors import InputError
from models.common.files import made_folder, together, whole_file
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.vehicle.lmi_certificates import certificate_texts

OPTION = "certificates"


def write_certificates(folder: Path, vehicle: Vehicle, controllers: Sequence[Controller]) -> list[str]:
    """Writes the LMI certificates of controllers to a folder. Returns the names of the written files.

    Raises:
        InputError: no controller has measurements, or the folder cannot be written.
    """
    texts = certificate_texts(vehicle, controllers)
    if not texts:
        raise InputError(
            f"--certificates {folder}: none of the selected controllers measures a signal, so there is nothing to "
            "certify; select a controller that measures signals"
        )
    with made_folder(folder, OPTION), together():
        for name, text in texts.items():
            with whole_file(folder / name, OPTION) as part:
                part.write_text(text, encoding="utf-8", newline="\n")
    return [*texts]
