//! The guidance service: modes, set-points and line of sight into smooth references.

use crate::los::{DesiredVelocity, LineOfSight, PortSign};
use crate::reference_model::{ReferenceModel, ReferenceModelConfig};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{Interval, NonNegative, Positive};
use supertwin_core::command::{GuidanceCommand, Setpoint, Trajectory};
use supertwin_core::message::{Direction, Mode, Nav, Reference};
use supertwin_core::{
    Block, Input, Notice, Notices, Observe, OperatorLink, PortRule, Probe, Refusal, Tick, Wired, Wires, parameter,
    signal,
};

/// A guidance file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GuidanceConfig {
    /// What it is and where its numbers come from.
    pub description: String,
    /// Δ of the line-of-sight law.
    pub lookahead_m: Positive,
    /// Which print of the law to port.
    pub port_sign: PortSign,
    /// Reference models.
    pub reference: ReferenceModels,
    /// What may be asked for.
    pub limits: SetpointLimits,
    /// Set-points before the first command.
    pub initial: InitialSetpoints,
}

/// Reference models of the four quantities.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReferenceModels {
    /// Surge and sway, in m/s: the rate is an acceleration.
    pub velocity: ReferenceModelConfig,
    /// Depth, in metres.
    pub depth: ReferenceModelConfig,
    /// Heading, in radians.
    pub heading: ReferenceModelConfig,
}

/// Bounds of the set-points; a command outside them is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SetpointLimits {
    /// Shallowest and deepest.
    pub depth_m: Interval,
    /// Nearest and farthest.
    pub net_distance_m: Interval,
    /// Fastest along the net.
    pub speed_m_per_s: Positive,
}

/// Set-points that hold until a command changes them. Depth and heading start where the vehicle is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InitialSetpoints {
    /// Distance to the net.
    pub net_distance_m: Positive,
    /// Speed along the net.
    pub speed_m_per_s: NonNegative,
    /// Direction of travel.
    pub direction: Direction,
}

impl GuidanceConfig {
    /// # Errors
    /// When an initial set-point breaks the limits, or the net may be approached to nothing.
    pub fn check(&self) -> Result<(), String> {
        let (limits, initial) = (&self.limits, &self.initial);
        if limits.net_distance_m.low() <= 0.0 {
            return Err(format!("limits.net_distance_m: {} must be positive", limits.net_distance_m.low()));
        }
        if !limits.net_distance_m.contains(initial.net_distance_m.get()) {
            return Err(format!(
                "initial.net_distance_m = {}: must lie between {} and {}",
                initial.net_distance_m.get(),
                limits.net_distance_m.low(),
                limits.net_distance_m.high()
            ));
        }
        if initial.speed_m_per_s.get() > limits.speed_m_per_s.get() {
            return Err(format!(
                "initial.speed_m_per_s = {}: must be at most {}",
                initial.speed_m_per_s.get(),
                limits.speed_m_per_s.get()
            ));
        }
        Ok(())
    }
}

/// What guidance consumes.
#[derive(Clone, Copy, Debug)]
pub struct GuidanceInput<'a> {
    /// Estimate of the state, from the estimator.
    pub nav: Input<&'a Nav>,
    /// The operator's link.
    pub operator: OperatorLink,
}

/// Why guidance does what it does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// Somebody said so.
    Commanded,
    /// Navigation has not arrived yet.
    WaitingForNav,
    /// Navigation is too old: the reference stands still.
    NavStale,
    /// No net to follow: holds.
    NetLost,
    /// Nobody is in command any more: holds.
    OperatorLost,
}

impl Reason {
    /// The name used in recordings and events.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Commanded => "commanded",
            Self::WaitingForNav => "waiting_for_nav",
            Self::NavStale => "nav_stale",
            Self::NetLost => "net_lost",
            Self::OperatorLost => "operator_lost",
        }
    }
}

/// The guidance of one run.
#[derive(Clone, Debug)]
pub struct Guidance {
    config: GuidanceConfig,
    line_of_sight: LineOfSight,
    nav_limit_ticks: u64,
    commanded: Mode,
    direction: Direction,
    /// Asked for; without them, the vehicle holds where it was when holding began.
    depth_m: Option<Trajectory>,
    heading_rad: Option<Trajectory>,
    hold_depth_m: f64,
    hold_heading_rad: f64,
    /// Asked for before anybody knew where the vehicle is.
    pending_depth: Option<Setpoint>,
    pending_heading: Option<Setpoint>,
    net_distance_m: Trajectory,
    speed_m_per_s: Trajectory,
    surge: ReferenceModel,
    sway: ReferenceModel,
    depth: ReferenceModel,
    heading: ReferenceModel,
    started: bool,
    mode: Mode,
    /// Why guidance is in its mode.
    pub reason: Reason,
    desired: DesiredVelocity,
    target: [f64; 2],
}

impl Guidance {
    /// From a guidance file; `nav_limit_s` is the age of navigation at which the reference stops moving.
    #[must_use]
    pub fn new(config: &GuidanceConfig, nav_limit_s: f64, dt_s: f64) -> Self {
        Self {
            config: config.clone(),
            line_of_sight: LineOfSight { lookahead_m: config.lookahead_m.get(), port_sign: config.port_sign },
            nav_limit_ticks: Tick::at_or_after(nav_limit_s, dt_s),
            commanded: Mode::Neutral,
            direction: config.initial.direction,
            depth_m: None,
            heading_rad: None,
            hold_depth_m: 0.0,
            hold_heading_rad: 0.0,
            pending_depth: None,
            pending_heading: None,
            net_distance_m: Trajectory::constant(config.initial.net_distance_m.get()),
            speed_m_per_s: Trajectory::constant(config.initial.speed_m_per_s.get()),
            surge: ReferenceModel::new(&config.reference.velocity),
            sway: ReferenceModel::new(&config.reference.velocity),
            depth: ReferenceModel::new(&config.reference.depth),
            heading: ReferenceModel::new(&config.reference.heading),
            started: false,
            mode: Mode::Neutral,
            reason: Reason::WaitingForNav,
            desired: DesiredVelocity::default(),
            target: [0.0; 2],
        }
    }

    /// What to do now, and why.
    fn decide(&self, nav: &Nav, operator: OperatorLink) -> (Mode, Reason) {
        match self.commanded {
            Mode::Neutral => (Mode::Neutral, Reason::Commanded),
            _ if operator == OperatorLink::Lost => (Mode::DepthHeadingHold, Reason::OperatorLost),
            Mode::FollowNet if !nav.net.valid => (Mode::DepthHeadingHold, Reason::NetLost),
            mode => (mode, Reason::Commanded),
        }
    }

    fn enter(&mut self, mode: Mode) {
        let was = core::mem::replace(&mut self.mode, mode);
        if was == mode {
            return;
        }
        // Holding begins where the references stand.
        if was == Mode::Neutral {
            self.hold_depth_m = self.depth.value;
        }
        match mode {
            Mode::DepthHeadingHold => self.hold_heading_rad = self.heading.value,
            // The net gives the heading from here on; a later hold starts from where that led.
            Mode::FollowNet => self.heading_rad = None,
            Mode::Neutral => {}
        }
    }

    /// The first navigation: references start where the vehicle is, and what was asked for before starts from there.
    fn start(&mut self, nav: &Nav, now: Tick) {
        self.started = true;
        self.depth.hold(nav.depth_m);
        self.heading.hold(nav.heading_rad);
        let begin = |pending: Option<Setpoint>, from: f64| {
            let mut trajectory = Trajectory::constant(from);
            trajectory.follow(pending?, now);
            Some(trajectory)
        };
        self.depth_m = begin(self.pending_depth.take(), nav.depth_m);
        self.heading_rad = begin(self.pending_heading.take(), nav.heading_rad);
    }

    fn reference(&self, now: Tick) -> Reference {
        let following = self.mode == Mode::FollowNet;
        let speed = if following { self.direction.sign() * self.speed_m_per_s.at(now) } else { 0.0 };
        Reference {
            mode: self.mode,
            surge_m_per_s: self.surge.value,
            surge_m_per_s2: self.surge.rate,
            sway_m_per_s: self.sway.value,
            sway_m_per_s2: self.sway.rate,
            depth_m: self.depth.value,
            depth_m_per_s: self.depth.rate,
            depth_m_per_s2: self.depth.acceleration,
            heading_rad: self.heading.value,
            heading_rad_per_s: self.heading.rate,
            heading_rad_per_s2: self.heading.acceleration,
            net_distance_m: self.net_distance_m.at(now),
            speed_m_per_s: speed,
        }
    }

    /// Other parameters from now on; references go on from where they are.
    fn retune(&mut self, config: GuidanceConfig) {
        self.line_of_sight = LineOfSight { lookahead_m: config.lookahead_m.get(), port_sign: config.port_sign };
        self.surge.retune(&config.reference.velocity);
        self.sway.retune(&config.reference.velocity);
        self.depth.retune(&config.reference.depth);
        self.heading.retune(&config.reference.heading);
        self.config = config;
    }

    fn rest(&mut self) {
        for model in [&mut self.surge, &mut self.sway, &mut self.depth, &mut self.heading] {
            let value = model.value;
            model.hold(value);
        }
    }
}

impl Block for Guidance {
    const NAME: &'static str = "guidance";
    type In<'a> = GuidanceInput<'a>;
    type Out = Reference;
    type Command = GuidanceCommand;

    fn step(&mut self, tick: Tick, input: GuidanceInput<'_>) -> Reference {
        // What is no number is no navigation.
        let usable = |nav: &&Nav| {
            [nav.depth_m, nav.heading_rad, nav.net.distance_m, nav.net.heading_rad].iter().all(|x| x.is_finite())
        };
        let Some(nav) = input.nav.within(tick, self.nav_limit_ticks).filter(usable) else {
            // The reference stops moving where it is.
            self.reason = if self.started { Reason::NavStale } else { Reason::WaitingForNav };
            self.rest();
            return self.reference(tick);
        };
        if !self.started {
            self.start(nav, tick);
        }
        let (mode, reason) = self.decide(nav, input.operator);
        self.reason = reason;
        self.enter(mode);
        let h_s = tick.dt_s;
        if mode == Mode::Neutral {
            // References wait where the vehicle drifts, so that nothing jumps when they are wanted again.
            self.surge.hold(0.0);
            self.sway.hold(0.0);
            self.depth.hold(nav.depth_m);
            self.heading.hold(nav.heading_rad);
            self.desired = DesiredVelocity::default();
            return self.reference(tick);
        }
        let depth_m = self.depth_m.map_or(self.hold_depth_m, |depth| depth.at(tick));
        let heading_rad = if mode == Mode::FollowNet {
            self.desired = self.line_of_sight.velocity(
                nav.net.distance_m,
                self.net_distance_m.at(tick),
                nav.net.heading_rad,
                nav.heading_rad,
                self.speed_m_per_s.at(tick),
                self.direction,
            );
            nav.net.heading_rad
        } else {
            self.desired = DesiredVelocity::default();
            self.heading_rad.map_or(self.hold_heading_rad, |heading| heading.at(tick))
        };
        self.target = [depth_m, heading_rad];
        self.surge.step(self.desired.surge_m_per_s, h_s);
        self.sway.step(self.desired.sway_m_per_s, h_s);
        self.depth.step(depth_m, h_s);
        self.heading.step_angle(heading_rad, h_s);
        self.reference(tick)
    }

    fn command(&mut self, tick: Tick, command: &GuidanceCommand) -> Result<(), Refusal> {
        match *command {
            GuidanceCommand::Parameter(ref change) => {
                if change.path == "description" || change.path.starts_with("initial") {
                    return Err(Refusal(format!("{}: only counts before the start", change.path)));
                }
                let config = parameter::changed(&self.config, change)?;
                config.check().map_err(Refusal)?;
                self.retune(config);
            }
            GuidanceCommand::Mode(mode) => self.commanded = mode,
            GuidanceCommand::Direction(direction) => self.direction = direction,
            GuidanceCommand::DepthM(setpoint) => {
                let (low, high) = (self.config.limits.depth_m.low(), self.config.limits.depth_m.high());
                setpoint.check("depth_m", low, high)?;
                if self.started {
                    self.depth_m.get_or_insert(Trajectory::constant(self.depth.value)).follow(setpoint, tick);
                } else {
                    self.pending_depth = Some(setpoint);
                }
            }
            GuidanceCommand::HeadingRad(setpoint) => {
                let turn = core::f64::consts::TAU;
                setpoint.check("heading_rad", -turn, turn)?;
                if self.started {
                    self.heading_rad.get_or_insert(Trajectory::constant(self.heading.value)).follow(setpoint, tick);
                } else {
                    self.pending_heading = Some(setpoint);
                }
            }
            GuidanceCommand::NetDistanceM(setpoint) => {
                let (low, high) = (self.config.limits.net_distance_m.low(), self.config.limits.net_distance_m.high());
                setpoint.check("net_distance_m", low, high)?;
                self.net_distance_m.follow(setpoint, tick);
            }
            GuidanceCommand::SpeedMPerS(setpoint) => {
                let high = self.config.limits.speed_m_per_s.get();
                setpoint.check("speed_m_per_s", 0.0, high)?;
                self.speed_m_per_s.follow(setpoint, tick);
            }
        }
        Ok(())
    }

    fn notices(&self, out: Option<&Reference>) -> Notices {
        let mode = Notice::info("mode", out.map_or("", |reference| reference.mode.name()));
        let usual = matches!(self.reason, Reason::Commanded | Reason::WaitingForNav);
        Notices::from_iter([mode, Notice::either(!usual, "reason", self.reason.name(), self.reason.name())])
    }

    fn parameters(&self) -> serde_json::Value {
        parameter::tree(&self.config)
    }
}

impl Wired for Guidance {
    fn input<'a>(wires: &mut impl Wires<'a>, operator: OperatorLink) -> GuidanceInput<'a> {
        GuidanceInput { nav: wires.newest(PortRule::TRIGGER), operator }
    }
}

impl Observe for Guidance {
    fn observe<P: Probe>(&self, probe: &mut P) {
        let d = &self.desired;
        probe.vector(
            &signal::guidance::LINE_OF_SIGHT,
            &[d.surge_m_per_s, d.sway_m_per_s, d.course_rad, d.cross_track_m],
        );
        probe.vector(&signal::guidance::TARGET, &self.target);
        probe.label(&signal::guidance::REASON, self.reason.name());
    }
}
