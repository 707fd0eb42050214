"""The version of greygate, which stands in every folder that it writes."""

__version__ = "0.1.0"
