"""The objective of a fit."""
