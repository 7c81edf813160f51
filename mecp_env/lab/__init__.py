"""Rivals of the parts of the estimator, and the paper's own, for comparison only; nothing else imports them.

They are parts of an installed package, as those of anybody else: an entry point in the group `mecp_env` names
this module, which is imported when a configuration names one of them.
"""

from mecp_env.lab.dobkin import find_dobkin
from mecp_env.lab.first_estimates import FirstEstimateEkf
from mecp_env.lab.mecp_paper import MecpPaperAssociator
from mecp_env.lab.rivals import CcdaAssociator, JcbbAssociator, NearestAssociator, nearest_descriptor, nearest_room
from mecp_env.slam.association import ASSOCIATORS
from mecp_env.slam.filters import FILTERS
from mecp_env.slam.mecp import STRUCTURES

ASSOCIATORS |= {
    "mecp_paper": MecpPaperAssociator,
    "jcbb": JcbbAssociator,
    "ccda": CcdaAssociator,
    "nearest": NearestAssociator,
    "nearest_room": nearest_room,
    "nearest_descriptor": nearest_descriptor,
}
FILTERS |= {"fej": FirstEstimateEkf}
STRUCTURES |= {"dobkin": find_dobkin}
