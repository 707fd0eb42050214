"""Structured networks: what they are (network), how they compute (activations, arithmetic), how they are judged
(accuracy, validation); `training` fits them, `families` builds them, `trained` holds those that come with greygate."""
