"""In which module each type is, made from the interface by `make contract`: change it there."""

from __future__ import annotations

MODULE_OF = {
    name: module
    for module, names in {
        "robots": """
            AxisReport CircleAxis FoundRobot Frame JointSummary Mesh OffPoint Pose RobotCheck RobotReport
            RobotSummary Zero
            """,
        "budgets": """
            Budget Contribution Correlation
            """,
        "kinematics": """
            Flanges Posture Postures
            """,
        "fits": """
            Axis Errors Figure IdentifiableSum Layout Legend LoadNumber Margin Member Metrics NullDirection
            Objection OddMass Origin Parameter Reference Remark Scene StageErrors Term Text
            """,
        "acceptance": """
            Acceptance JudgedCampaign
            """,
        "campaigns": """
            Board Camera Campaign Conditions Instrument Upload Uploaded
            """,
        "cameras": """
            BoardFound CameraFound LeftOpen PixelsFound ToolScatter
            """,
        "fleet_priors": """
            FleetVersion LeftOneOut PriorUsed
            """,
        "identifications": """
            Configuration CorrelatedGroup IdentifyResult Influence JointMotions JointParametersResult KindErrors
            KindOfMeasurement Learned MassesTaken Method Motion Noise Observability OwnBase Scale SetAside
            """,
        "comparisons": """
            Comparison PairedErrors ParameterChange Rival Tombstone VersionDiff
            """,
        "previews": """
            JointPreview VersionPreview
            """,
        "versions": """
            ActivatedVersion Activation CorrectionLimits Covariance Details UsedCampaign Version VersionSummary
            Workspace
            """,
        "search_numbers": """
            Adequacy AliasMatrix AliasPair Amplitude AtJoints Evidence GapNoise GapSize GapStep Gates
            NegativeControl Place Predictive RepeatDrift ShuffledEffect UnseenFit
            """,
        "effect_curves": """
            CurveDistance CurveRival CurveSide CurveVisits EffectCurve
            """,
        "searches": """
            Alias Amount Claim Detectable GapKind GapResult Halves HeldOutGain NamedEffect NextPose PhysicalClass
            Refused Replication Separation ToldApart Untestable
            """,
        "evaluations": """
            CampaignErrors Criterion CriterionOfPose EvaluateResult Iso9283 RefusedCriterion RowErrors
            """,
        "plans": """
            PlanResult PlannedPose Proposal SmallestChange
            """,
        "drifts": """
            ChangedNumber CheckOfRobot ControlChart DriftCause DriftHistory DriftList DriftMark DriftResult
            DriftSummary Repair RezeroResult
            """,
        "server": """
            Bridge BridgeList Check ErrorsToday Health JobError JobSummary MeasuredCampaign NamedMissing Progress
            ResolvedReference SearchToday Today
            """,
        "checks": """
            CheckedCampaign DriftCheck Duration EvaluateCheck GapCheck HeldOut Identifiability IdentifyCheck
            JobProblem JointParametersCheck Missing PlanCheck RezeroCheck Testability UnknownParameter
            """,
        "jobs": """
            DriftJob EvaluateJob GapJob IdentifyJob JointParametersJob PlanJob RezeroJob
            """,
        "others": """
            AuditChange AuditEntry AuditPage CheckedRows FleetCounts FleetJob FleetJobSummary FleetRobot Identity
            LoginLink MadeToken ResidualRows StreamSession SuspiciousRow SuspiciousRows Token UrdfShape UrdfShapes
            """,
    }.items()
    for name in names.split()
}
JOBS = {
    "drift": "DriftJob",
    "evaluate": "EvaluateJob",
    "gap": "GapJob",
    "identify": "IdentifyJob",
    "joint_parameters": "JointParametersJob",
    "plan": "PlanJob",
    "rezero": "RezeroJob",
}
