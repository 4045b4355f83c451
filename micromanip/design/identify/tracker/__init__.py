"""A model of one axis' path deviation from tracker samples: what its predictor is made of."""
