"""Rates that counting cannot reach: ``budget=rare`` draws frames where errors are expected and weighs them."""

from vocc_torch.extras.rare.pilot import weighed_job as weighed_job
