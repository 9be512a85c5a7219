"""The verifier of CommonRoad's designer checks scenarios by its formulas."""

import contextlib
import io
import logging

import counted
import crdesigner.verification_repairing.verification.map_verifier as verifier
from commonroad.common.file_reader import CommonRoadFileReader
from crdesigner.verification_repairing.verification.formula_ids import extract_formula_ids

logging.disable(logging.CRITICAL)


def read(file):
    found = []
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        network = CommonRoadFileReader(file).open()[0].lanelet_network
        for formula in extract_formula_ids():
            config = verifier.MapVerParams()
            config.verification.formulas = [formula]
            try:
                states = verifier.MapVerifier(network, config).verify()
            except TypeError:
                # It fails if the network has nothing that the formula is about, such as lights.
                continue
            found += [f"{kind.value}: {next(iter(places))}" for kind, places in states.items() if places]
    return {"lanelets": len(network.lanelets), "warnings": found}


counted.main(read)
