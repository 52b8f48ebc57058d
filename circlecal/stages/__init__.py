"""The stages of a calibration: one file, one stage, one public function, one configuration model."""
