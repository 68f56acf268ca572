"""The equations of motion about states: their derivatives, and linear systems in minimal coordinates."""
