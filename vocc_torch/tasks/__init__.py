"""What each task does and writes: studies and reports put together."""

from vocc_torch.tasks.decoding import run_decode
from vocc_torch.tasks.figures import run_figures
from vocc_torch.tasks.testing import run_test
from vocc_torch.tasks.training import run_train

__all__ = ["run_decode", "run_figures", "run_test", "run_train"]
