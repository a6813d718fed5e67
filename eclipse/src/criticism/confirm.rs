//! Sealed data opened: which refits they confirm.

use super::{
    compete::Choice,
    diagnosis::{Judged, Refitted},
    fit::{Fit, FitError},
    frame_numbers::FrameNumbers,
    refit::Round,
    sealed::{self, Gain, Judge, Noise},
    study::Study,
};

/// Probability below which a gain on sealed data agrees with screening, for the best refit of a round; the second best has half of it.
///
/// Screening has chosen at 1 % after Holm's correction and at three standard errors, against a model that has converged. Sealed data are
/// there to refuse what does not carry over, not to find it anew: they are a sixth as many as those of development, so that an effect of
/// four standard errors in screening has but 1.6 there. At 5 % half of such effects would be refused, at 30 % one in eight; and of what
/// screening lets pass by chance three in ten remain.
const SEALED_LEVEL: f64 = 0.3;

/// What sealed data confirm.
pub struct Opened<'a> {
    /// What stands, in order.
    pub path: Vec<Step<'a>>,
    /// Capacity candidates that the model needed first, in order.
    pub finer: Vec<&'static str>,
    /// A stand-in for physics outside the table that does best.
    pub unknown: Option<&'static str>,
    /// Whether an effect that refits speak for gains there, but not enough.
    pub refused: bool,
}

/// One effect that stands.
pub struct Step<'a> {
    /// The effect.
    pub choice: &'a Choice,
    /// The model with it.
    pub fit: &'a Fit,
    /// What sealed data gain.
    pub gain: Gain,
    /// Effects of its round that sealed data refused before it.
    pub refused: Vec<&'static str>,
}

/// Asks the sealed data: of every round the best refit, be it a stand-in for what no table has, and, where they refuse it, the next
/// best at a stricter level. Later rounds began with the best, so that they are not looked at when it is refused.
///
/// # Errors
/// A bug of the tape.
pub fn open<'a>(
    study: &Study<'_>,
    rounds: &'a [Round],
    refits: &mut [Refitted],
) -> Result<Opened<'a>, FitError> {
    let mut opened = Opened {
        path: Vec::new(),
        finer: Vec::new(),
        unknown: None,
        refused: false,
    };
    for (after, round) in rounds.iter().enumerate() {
        let mut ask = |id: &'static str, fit: &Fit, level: f64| -> Result<_, FitError> {
            let judge = Judge::new(study, &round.null, fit, Noise::Estimated);
            let unknown = FrameNumbers::of(study, fit)?;
            let [null, with] = [&round.null, fit].map(|fit| judge.errors(study, fit, &unknown));
            let gain = sealed::gain(study, &null, &with, true);
            let confirmed = gain.gain > 0.0 && gain.p < level;
            tracing::debug!(id, gain.gain, gain.error, gain.p, confirmed, "sealed");
            let own = |r: &&mut Refitted| r.after == after && r.id == id;
            if let Some(refit) = refits.iter_mut().find(own) {
                refit.sealed = Some(Judged {
                    gain: gain.gain,
                    gain_se: gain.error,
                    p: gain.p,
                    confirmed,
                });
            }
            Ok((gain, confirmed))
        };
        if let Some((id, fit)) = &round.unknown {
            let (_, confirmed) = ask(id, fit, SEALED_LEVEL)?;
            if confirmed {
                opened.unknown = Some(*id);
                break;
            }
        }
        if let Some((id, fit)) = &round.finer {
            let (_, confirmed) = ask(id, fit, SEALED_LEVEL)?;
            if !confirmed {
                break;
            }
            opened.finer.push(*id);
            continue;
        }
        // Every question makes the next one stricter.
        let asked = 1 + usize::from(round.unknown.is_some());
        let (mut stood, mut refused) = (None, Vec::new());
        for (rank, (choice, fit)) in round.standing.iter().enumerate() {
            let level = SEALED_LEVEL / (rank + asked) as f64;
            let (gain, confirmed) = ask(choice.score.id, fit, level)?;
            if confirmed {
                stood = Some(rank);
                opened.path.push(Step {
                    choice,
                    fit,
                    gain,
                    refused,
                });
                break;
            }
            refused.push(choice.score.id);
            opened.refused |= gain.gain > 0.0;
        }
        if stood != Some(0) || round.unknown.is_some() {
            break;
        }
    }
    Ok(opened)
}
