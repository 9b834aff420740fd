"""
Fisher's discriminant on scikit-learn's data
============================================

``vt.FLDA`` is an estimator by itself. With equal priors it decides as scikit-learn's
``LinearDiscriminantAnalysis`` does.
"""

import matplotlib.pyplot as plt
import torch
from sklearn.datasets import load_breast_cancer
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

import vocc_torch as vt

x, y = map(torch.tensor, load_breast_cancer(return_X_y=True))
scores = vt.FLDA(x.shape[1]).fit(x[::2], y[::2]).decision_function(x[1::2])
lda = LinearDiscriminantAnalysis(priors=[0.5, 0.5]).fit(x[::2], y[::2])
same = ((scores >= 0).numpy() == lda.predict(x[1::2])).mean()

plt.figure(figsize=(7, 3.4), layout="constrained")
plt.hist([scores[y[1::2] == 0], scores[y[1::2] == 1]], bins=40, stacked=True)
plt.legend(["malignant", "benign"])
plt.title(f"{same:.0%} of the decisions are those of scikit-learn")
plt.xlabel("score; 0 is the threshold")
plt.show()
