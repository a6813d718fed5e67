//! What a run leaves in its checkpoint, and how it goes on from there.

use std::collections::BTreeMap;

use super::{
    super::{
        fast::{self, Start},
        shading::Lobe,
    },
    LEGS, Place, Run,
    round::RoundStart,
};
use crate::checkpoint::{Array, Checkpoint, CheckpointError};

impl Run<'_> {
    pub(super) fn state(&self, place: Place, step: &fast::Step<'_>) -> Checkpoint {
        let begun = self.round.as_ref();
        let lobe = begun.and_then(|begun| begun.lobe);
        let lobe = lobe.map_or(Vec::new(), |lobe| vec![lobe.alpha, lobe.kappa]);
        let begun = begun.map_or(Vec::new(), |begun| begun.z.clone());
        Checkpoint {
            settings: self.settings.clone(),
            capture: self.fingerprint,
            iteration: self.iteration(),
            seconds: self.seconds(),
            arrays: BTreeMap::from([
                ("z".to_owned(), Array::F32(step.z.to_vec())),
                ("damping".to_owned(), Array::F32(vec![step.damping])),
                (
                    "stage".to_owned(),
                    Array::U64(
                        [place.stage, place.round, step.step + 1]
                            .map(|n| n as u64)
                            .to_vec(),
                    ),
                ),
                ("curve".to_owned(), Array::curve(&self.curve)),
                ("lobe".to_owned(), Array::F32(lobe)),
                ("round".to_owned(), Array::F32(begun)),
            ]),
        }
    }

    /// The stage to go on with and where in it.
    pub(super) fn resume(
        &mut self,
        checkpoint: &Checkpoint,
    ) -> Result<([usize; 2], Option<Start>), CheckpointError> {
        let length = |name: &str| match checkpoint.arrays.get(name) {
            Some(Array::F32(values)) => values.len(),
            Some(Array::F64(values)) => values.len() / 4,
            _ => 0,
        };
        if length("round") > 0 {
            let lobe = checkpoint.f32s("lobe", length("lobe").min(2))?;
            self.round = Some(RoundStart {
                z: checkpoint.f32s("round", length("round"))?.to_vec(),
                lobe: (lobe.len() == 2).then(|| Lobe {
                    alpha: lobe[0],
                    kappa: lobe[1],
                }),
            });
        }
        let z = checkpoint.f32s("z", length("z"))?.to_vec();
        let damping = checkpoint.f32s("damping", 1)?[0];
        let place = checkpoint.u64s("stage", 3)?;
        self.curve = checkpoint.curve(length("curve"))?;
        self.before = checkpoint.seconds;
        let stage = (place[0] as usize).min(LEGS.len() - 1);
        let round = (place[1] as usize).min(LEGS[stage].held.len() - 1);
        let step = place[2] as usize;
        Ok(([stage, round], Some(Start { z, damping, step })))
    }
}
