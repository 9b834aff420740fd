"""Many receivers on the same frames, beside what is possible, what they cost, and other scenes."""

from vocc_torch.studies.rivals.plan import RivalStudy as RivalStudy
from vocc_torch.studies.rivals.study import Told as Told
from vocc_torch.studies.rivals.study import compare_rivals as compare_rivals
