"""The paper's claims and quoted numbers against what was measured: agree, differ or cannot say, and why."""

from vocc_torch.studies.paper.scorecard.claim import Claim
from vocc_torch.studies.paper.scorecard.claims import CLAIMS
from vocc_torch.studies.paper.scorecard.fit import BestReading, Distance, Fit, best_reading, fits
from vocc_torch.studies.paper.scorecard.judgement import VERDICTS, Judgement, Verdict
from vocc_torch.studies.paper.scorecard.location import LocationSplit, location_rows, location_split
from vocc_torch.studies.paper.scorecard.reading import Findings, Reading
from vocc_torch.studies.paper.scorecard.score import Scorecard, readings_of, score

__all__ = [
    "CLAIMS",
    "VERDICTS",
    "BestReading",
    "Claim",
    "Distance",
    "Findings",
    "Fit",
    "Judgement",
    "LocationSplit",
    "Reading",
    "Scorecard",
    "Verdict",
    "best_reading",
    "fits",
    "location_rows",
    "location_split",
    "readings_of",
    "score",
]
