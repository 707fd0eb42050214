"""Models by the exporters of PyTorch (both), Keras and scikit-learn: right beside onnxruntime, refused, or wrong.

Exit code 1 if one is wrong or ends in a traceback.
"""

from collections import Counter

from exported_models import AGREED, STEPS, judged, made

from .made import keep
from .shared import scratch

TAKES = "two minutes"


def main() -> int:
    rows, counts = [], Counter()
    with scratch() as folder:
        for file in made(folder):
            verdict, said = judged(file)
            counts[verdict] += 1
            rows.append({"model": file.stem, "verdict": verdict, "said": said.replace(f"{folder}/", "")})
            print(rows[-1], flush=True)
    kinds = ("right", "refused", "wrong", "traceback")
    keep("exported", "models", {"steps": STEPS, "agreed": AGREED, "total": {k: counts[k] for k in kinds}, "rows": rows})
    return int(bool(counts["wrong"] + counts["traceback"]))
