#!/usr/bin/env bash
# A scikit-learn estimator needs no file at all.
vocc-torch classifier=sklearn classifiers.sklearn.build._target_=sklearn.naive_bayes.GaussianNB "$@"
