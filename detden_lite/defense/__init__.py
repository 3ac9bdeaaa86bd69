"""The defender's side: two GRU-VAEs, a detector that says when to defend and a denoiser that says how (section 3.1).

Beside them: the ``baselines`` that they have to beat, and the ``oracles`` that none can.
"""

from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.detector import Detector
from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.pipeline import DetectAndDenoise, Verdict

__all__ = ["GRUVAE", "Denoiser", "DetectAndDenoise", "Detector", "Verdict"]
