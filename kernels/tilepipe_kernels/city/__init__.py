"""A procedural city: streets, buildings, trees and cars as functions of a seed and of the global row and column.

Nothing is drawn in an order and nothing is stored, so a window holds the same pixels however a city is cut.
"""
