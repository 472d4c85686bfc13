use super::*;
use crate::dynamics::Scene;
use crate::place;

/// One sensor that a search places, and may place again before steps 1, 2 and 3.
fn restless(brain: Kind) -> Problem {
    let problem = small(Protocol::Joint(GOING));
    let (method, candidates) = (place::Method::Greedy, (4..12).collect());
    Problem {
        search: Some(place::Search { method, candidates, sensors: 1, turn: 0, spacing: 0.0 }),
        scene: Scene { sensors: Vec::new(), ..problem.scene },
        optimise: Optimise { again: true, brain, ..problem.optimise },
        ..problem
    }
}

/// A sensor that stands where it is worth least moves as soon as it is time for it; stopped after that and resumed: the
/// same bits. The best body is evaluated by the sensor that it has, the initial one by the one that it had. Without
/// `again` nothing moves.
#[test]
fn sensors_are_placed_again() {
    for brain in [Kind::Network, Kind::Linear] {
        let problem = restless(brain);
        let search = problem.search.as_ref().unwrap();
        let candidates = Candidates::new(&problem, search, &problem.initial, &pool(2)).unwrap();
        let worst = candidates.worth(&[], 1e-4, &problem, &pool(2)).last().unwrap().0;
        let (own, _) = placed(&problem, &pool(2)).unwrap();
        let badly = Move { step: 0, units: vec![worst] };
        let start = State { moves: vec![badly.clone()], ..State::new(&own, &own.shape()) };

        let run = |from: State, threads: usize, keeper: &mut Keeper| {
            optimise(&problem, Some(from), &pool(threads), keeper).unwrap()
        };
        let mut whole = Keeper::default();
        let through = run(start.clone(), 2, &mut whole).unwrap();
        assert_eq!(through.moves[0], badly);
        assert!(through.moves[1].step == 1 && through.moves[1].units != badly.units, "{:?}", through.moves);
        let last = through.moves.last().unwrap().clone();
        let stop = last.step as usize;
        let mut first = Keeper { stop_after: Some(stop), ..Default::default() };
        assert!(run(start, 1, &mut first).is_none());
        let state = first.states.pop().unwrap();
        assert_eq!((&state, &state.moves), (&whole.states[stop - 1], &through.moves));
        assert!(state.weights.is_empty() && state.best.is_none());
        let resumed = run(state, 3, &mut Keeper::default()).unwrap();
        assert_eq!(resumed.optimised.design, through.optimised.design);
        assert_eq!(figures(&resumed.optimised), figures(&through.optimised));

        let still = Problem { optimise: Optimise { again: false, ..problem.optimise }, ..problem.clone() };
        let still = optimise(&still, None, &pool(2), &mut Keeper::default()).unwrap().unwrap();
        assert!(still.moves.is_empty());
        assert_eq!(figures(&still.initial), figures(&through.initial));
        let there = Problem {
            search: None,
            scene: Scene { sensors: last.units, ..problem.scene.clone() },
            ..problem.clone()
        };
        let designs = [through.optimised.design.clone()];
        let again = evaluate_designs(&there, &designs, &pool(2), &mut Keeper::default()).unwrap();
        assert_eq!(figures(&again[0]), figures(&through.optimised));
    }
}
