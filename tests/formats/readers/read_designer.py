"""The verifier of CommonRoad's designer checks scenarios by its formulas."""

import contextlib
import io
import logging

import counted
from commonroad.common.file_reader import CommonRoadFileReader
from crdesigner.verification_repairing.config import MapVerParams
from crdesigner.verification_repairing.verification.formula_ids import extract_formula_ids
from crdesigner.verification_repairing.verification.hol.mapping import HOLMapping
from crdesigner.verification_repairing.verification.hol.satisfaction import HOLVerificationChecker

logging.disable(logging.CRITICAL)
# Its own call parses all formulas and maps the network again for each formula, which takes five sixths of the time.
CONFIG = MapVerParams()


def read(file):
    found = []
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        network = CommonRoadFileReader(file).open()[0].lanelet_network
        mapping = HOLMapping(network, CONFIG)
        mapping.map_lanelet_network()
        for formula in extract_formula_ids():
            results = []
            try:
                HOLVerificationChecker(mapping, [formula]).check_validity(CONFIG.verification, results)
            except TypeError:
                # It fails if the network has nothing that the formula is about, such as lights.
                continue
            found += [f"{kind.value}: {next(iter(places))}" for kind, places in results[0].items() if places]
    return {"lanelets": len(network.lanelets), "warnings": found}


counted.main(read)
