# SPDX-License-Identifier: Apache-2.0
"""Read identification.json, the posterior of an identified robot."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.files.text_file import read_text
from fjr_design.posterior.result import Identification


def read_identification(path: Path) -> Identification:
    """Return the identification in a file; raises ParameterError, which names the file."""
    try:
        return parsed_identification(json.loads(read_text(path)))
    except OSError as error:
        raise ParameterError(f"cannot read identification {path}: {error.strerror}") from None
    except (ValueError, ParameterError) as error:  # JSONDecodeError and UnicodeDecodeError are ValueErrors
        raise ParameterError(f"{path}: {error}") from None


def parsed_identification(values: object) -> Identification:
    """Return the identification of plain values; raises ParameterError."""
    try:
        found = Identification.from_dict(values)  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ParameterError(
            f"is no identification ({error!r}); expected the file identification.json of an identified robot"
        ) from None
    p = len(found.free)
    shapes = len(found.coordinates), found.mean.shape, found.covariance.shape
    if shapes != (p, (p,), (p, p)) or not all(0 <= i < len(found.estimates) for i in found.free):
        raise ParameterError(f"has a posterior of sizes {shapes} for {p} parameters; expected equal sizes")
    if not (np.all(np.isfinite(found.mean)) and np.all(np.isfinite(found.covariance))):
        raise ParameterError("has a posterior that is not finite; expected finite means and covariances")
    return found
