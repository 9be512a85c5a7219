"""OpenUSD's validators check a stage."""

import counted
from pxr import Usd, UsdPhysics, UsdValidation

VALIDATORS = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()


def read(file):
    stage = Usd.Stage.Open(file)
    found = UsdValidation.ValidationContext(VALIDATORS).Validate(stage)
    solids = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    return {"objects": len(solids) - 1, "warnings": [one.GetMessage() for one in found]}


counted.main(read)
