"""An extension of gtau: an export, a log format, a robot and an estimator."""
