"""Uses of an identified model: predicting torques, weighing payloads, finding external torques and wrenches."""
