"""What ASAM's checker of OpenDRIVE finds in files: a line of JSON for each. It runs in an environment of its own."""

import inspect
import json
import logging
import sys
from functools import cache

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
for file in sys.argv[1:]:
    config, result = Configuration(), Result()
    config.set_config_param("InputFile", file)
    result.register_checker_bundle(name=constants.BUNDLE_NAME, description="", version="1")
    main.run_checks(config, result)
    checks = result.get_checker_ids(constants.BUNDLE_NAME)
    issues = [one.description for check in checks for one in result.get_issues(constants.BUNDLE_NAME, check)]
    completed = sum(result.get_checker_status(check).name == "COMPLETED" for check in checks)
    print(json.dumps({"file": file, "completed": completed, "issues": issues}), flush=True)
    for function in kept:
        function.cache_clear()
