"""Other arms of a type as a prior: versions in one gauge, their mean and spread, and whether an arm is as its type."""
