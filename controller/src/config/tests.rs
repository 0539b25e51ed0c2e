//! What is read, and what is refused with which message.

use program::Exit;
use vpc::Strategy;

use super::*;

fn parse(text: &str, arguments: &Arguments) -> Result<Config, ConfigError> {
    Config::parse(text, "/etc/v.toml", Path::new("/etc"), arguments)
}

fn refused(text: &str) -> String {
    let error = parse(text, &Arguments::default()).unwrap_err();
    assert_eq!(super::exit(&error), Exit::Config);
    error.to_string()
}

#[test]
fn an_empty_file_with_a_scene_is_the_default() {
    let config = parse("scene = 's.toml'", &Arguments::default()).unwrap();
    assert_eq!(config.scene, Path::new("/etc/s.toml"));
    // The law by itself is the paper's.
    let expected = Settings {
        strategy: vpc::Strategy::Foresight,
        brake_s: 0.15,
        ..Settings::default()
    };
    assert_eq!(config.settings, expected);
    assert_eq!(
        (config.clock, config.safety.stale_periods),
        (ClockMode::Fixed, 3.0)
    );
    assert_eq!(config.domain, ipc::default_directory());
}

#[test]
fn flight_records_lie_beside_the_domain_or_where_the_file_says() {
    let directory = |text: &str| {
        let config = parse(text, &Arguments::default()).unwrap();
        config.flight.directory
    };
    let domain = "scene = 's'\n[ipc]\ndomain = '/run/d'\n";
    assert_eq!(directory(domain), Path::new("/run/d-flight"));
    let text = format!("{domain}[flight]\ndirectory = 'records'");
    assert_eq!(directory(&text), Path::new("/etc/records"));
}

#[test]
fn flags_win_and_their_paths_are_their_own() {
    let flags = Arguments {
        scene: Some("other.toml".into()),
        strategy: Some("ibvs".into()),
        np: Some(30),
        clock: Some("lockstep".into()),
        ..Arguments::default()
    };
    let config = parse("scene = 's.toml'\n[law]\nnp = 5", &flags).unwrap();
    assert_eq!(config.scene, Path::new("other.toml"));
    assert_eq!(
        (config.settings.np, config.settings.strategy),
        (30, Strategy::Ibvs)
    );
    assert_eq!(config.clock, ClockMode::Lockstep);
}

#[test]
fn a_refusal_names_file_key_value_and_range() {
    for (text, words) in [
        (
            "[law]\nnp = 41",
            "/etc/v.toml: law.np = 41; allowed: 1 to 40",
        ),
        ("[law]\nnp = -3", "law.np = -3; allowed: 1 to 40"),
        ("[law]\nnc = 4", "law.nc = 4; allowed: 1 to 4, at most np"),
        (
            "[law]\ntolerance = nan",
            "law.tolerance = NaN; allowed: 1e-15 to 1",
        ),
        (
            "[law]\ntrigger_px = -1.0",
            "law.trigger_px = -1; allowed: 0 to 1e4 px",
        ),
        (
            "[law]\nstrategy = 'knn65'",
            "law.strategy = knn65; allowed: previous, knn",
        ),
        (
            "[law]\nmodel = 'guess'",
            "law.model = guess; allowed: target-depth",
        ),
        (
            "[cycle]\nclock = 'sun'",
            "cycle.clock = sun; allowed: fixed, phase, lockstep",
        ),
        (
            "[cycle]\nstale_periods = 1.5",
            "cycle.stale_periods = 1.5; allowed: 2 to 1000",
        ),
        (
            "[safety]\nbrake_s = 0.2",
            "safety.brake_s = 0.2; allowed: 0 to 0.15 s",
        ),
        (
            "[safety]\nlost_s = -inf",
            "safety.lost_s = -inf; allowed: 0.1 to 10 s",
        ),
        (
            "[realtime]\npriority = 100",
            "realtime.priority = 100; allowed: 1 to 99",
        ),
        (
            "[realtime]\ncpu = 1",
            "realtime.priority is missing; allowed: 1 to 99, where realtime.cpu",
        ),
        (
            "[realtime]\npriority = 80\ncpu = -1",
            "realtime.cpu = -1; allowed: 0 to 1023",
        ),
        (
            "[cycle]\nmargin_ms = nan",
            "cycle.margin_ms = NaN; allowed: 0 to 20 ms",
        ),
        (
            "[flight]\nminutes = nan",
            "flight.minutes = NaN; allowed: 0.1 to 60 min",
        ),
        (
            "[flight]\nkeep = 0",
            "flight.keep = 0; allowed: 1 to 1000 files",
        ),
        ("[log]\nlevel = 'loud'", "log.level = loud; allowed: off"),
        (
            "[log]\nformat = 'xml'",
            "log.format = xml; allowed: text, json",
        ),
        (
            "[law]\nstrategy = 'gpr'",
            "/etc/v.toml: memory is missing; allowed: a memory",
        ),
    ] {
        let message = refused(&format!("scene = 's.toml'\n{text}"));
        assert!(message.contains(words), "{message}\nlacks {words}");
    }
    assert!(refused("").contains("/etc/v.toml: scene is missing"));
}

#[test]
fn delay_compensation_is_on_and_can_be_switched_off() {
    let compensation = |text: &str| {
        let config = parse(&format!("scene = 's'\n{text}"), &Arguments::default()).unwrap();
        config.settings.delay_compensation
    };
    assert!(compensation(""));
    assert!(!compensation("[law]\ndelay_compensation = false"));
}

#[test]
fn an_unknown_key_and_a_wrong_type_are_shown_in_their_line() {
    let message = refused("scene = 's.toml'\n[law]\nnpp = 3");
    assert!(
        message.contains("line 3") && message.contains("unknown field `npp`"),
        "{message}"
    );
    let message = refused("scene = 's.toml'\n[law]\nnp = 'three'");
    assert!(
        message.contains("line 3") && message.contains("invalid type"),
        "{message}"
    );
}

#[test]
fn a_wrong_flag_is_an_error_of_usage() {
    let flags = Arguments {
        np: Some(0),
        ..Arguments::default()
    };
    let error = parse("scene = 's.toml'", &flags).unwrap_err();
    assert_eq!(super::exit(&error), Exit::Usage);
    assert_eq!(
        error.to_string(),
        "command line: --np = 0; allowed: 1 to 40"
    );
}

#[test]
fn only_lockstep_starts_armed_unless_it_is_asked_for() {
    let armed = |text: &str, arguments: &Arguments| {
        let text = format!("scene = 's'\n{text}");
        parse(&text, arguments).unwrap().safety.armed
    };
    let none = Arguments::default();
    assert!(!armed("", &none));
    assert!(armed("[cycle]\nclock = 'lockstep'", &none));
    assert!(!armed(
        "[cycle]\nclock = 'lockstep'\n[safety]\narmed = false",
        &none
    ));
    assert!(armed("[safety]\narmed = true", &none));
    let flag = Arguments {
        arm: true,
        ..Arguments::default()
    };
    assert!(armed("[safety]\narmed = false", &flag));
}

#[test]
fn what_is_printed_is_the_same_configuration() {
    let flags = Arguments {
        np: Some(7),
        ..Arguments::default()
    };
    for text in [
        "scene = 's.toml'",
        "scene = 's.toml'\nmemory = 'm'\n[cycle]\nclock = 'lockstep'\n[realtime]\npriority = 5",
    ] {
        let document = Document::parse(text, "v.toml").unwrap();
        let (tables, config, _) = laid_over(document, Path::new("/etc"), &flags).unwrap();
        let printed = toml::to_string(&tables).unwrap();
        assert_eq!(parse(&printed, &Arguments::default()).unwrap(), config);
        assert!(printed.contains("np = 7"), "{printed}");
    }
    let refused = Config::print(&flags).unwrap_err().to_string();
    assert!(
        refused.contains("command line: scene is missing"),
        "{refused}"
    );
}
