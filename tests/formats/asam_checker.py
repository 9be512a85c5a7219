"""What ASAM's checker of OpenDRIVE finds in files: a line of JSON for each. It runs in an environment of its own."""

import json
import logging
import sys

from qc_baselib import Configuration, Result
from qc_opendrive import constants, main

logging.disable(logging.CRITICAL)
for file in sys.argv[1:]:
    config, result = Configuration(), Result()
    config.set_config_param("InputFile", file)
    result.register_checker_bundle(name=constants.BUNDLE_NAME, description="", version="1")
    main.run_checks(config, result)
    checks = result.get_checker_ids(constants.BUNDLE_NAME)
    issues = [one.description for check in checks for one in result.get_issues(constants.BUNDLE_NAME, check)]
    completed = sum(result.get_checker_status(check).name == "COMPLETED" for check in checks)
    print(json.dumps({"file": file, "completed": completed, "issues": issues}), flush=True)
