"""ASAM's checker of OpenDRIVE runs all its checks."""

import inspect
import logging
from functools import cache

import counted
from qc_baselib import Configuration, Result
from qc_opendrive import constants, main
from qc_opendrive.base import utils

logging.disable(logging.CRITICAL)
# The checker asks each road for the same values again for each of its neighbours. Kept, they take half the time.
kept = []
for name, function in vars(utils).copy().items():
    if name.startswith("get_") and {"road", "lane", "lane_section"} & inspect.signature(function).parameters.keys():
        kept.append(cache(function))
        setattr(utils, name, kept[-1])


def read(file):
    config, result = Configuration(), Result()
    config.set_config_param("InputFile", file)
    result.register_checker_bundle(name=constants.BUNDLE_NAME, description="", version="1")
    main.run_checks(config, result)
    checks = result.get_checker_ids(constants.BUNDLE_NAME)
    completed = sum(result.get_checker_status(check).name == "COMPLETED" for check in checks)
    assert completed == 22, f"{completed} checks of 22"
    for function in kept:
        function.cache_clear()
    return {
        "warnings": [one.description for check in checks for one in result.get_issues(constants.BUNDLE_NAME, check)]
    }


counted.main(read)
