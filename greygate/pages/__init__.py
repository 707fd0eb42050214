"""The pages a person reads: report, summary, validation, diagnosis."""
