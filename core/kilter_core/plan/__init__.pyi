from .d_optimal import d_optimal_poses as d_optimal_poses
from .d_optimal import five_poses as five_poses
from .d_optimal import inclinometer_poses as inclinometer_poses
from .d_optimal import iso_poses as iso_poses
from .views import placed_by_views as placed_by_views
from .views import view_poses as view_poses
